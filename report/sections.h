#pragma once

#include <string>
#include <vector>

#include "report/html.h"
#include "report/run_folder.h"

namespace omentum {

/// Tiles under the title: the run in six numbers. Several runs are seeds of one experiment
/// throughout.
std::string make_overview(const std::vector<RunFolder>& runs);

/// Learning curves over steps: mean and range over the seeds, the configuration's milestones as
/// dashed lines.
Section make_learning_section(const std::vector<RunFolder>& runs);

/// Per evaluation set on the grid of starts: exposure (figure 5) and success, mean over the seeds.
Section make_grid_section(const std::vector<RunFolder>& runs);

/// Success against each parameter that was drawn alone: a chart per parameter, five ranges of its
/// values. Without such sets the section is empty.
Section make_drawn_section(const std::vector<RunFolder>& runs);

/// The starts of the robot's grid: held, lost on lifting, not held (figure 7).
Section make_robot_section(const std::vector<RunFolder>& runs);

/// Exposure by grasped particle, with the best point.
Section make_lattice_section(const std::vector<RunFolder>& runs);

/// Success over the robot's starts against each parameter of the grasp that can fail: one chart per
/// parameter, the value of the configuration as a dashed line. Of the first run that has a study.
Section make_grasp_section(const std::vector<RunFolder>& runs);

/// The figures of summary.json: of every evaluation, with Wilson intervals, and of the training;
/// and figures.csv.
Section make_numbers_section(const std::vector<RunFolder>& runs);

/// The resolved configuration, and a line for all that could not be read.
Section make_config_section(const std::vector<RunFolder>& runs,
                            const std::vector<std::string>& damaged);

/// Whether a set belongs to the robot's grid.
bool is_robot_set(const std::string& name);

/// Whether a set is the greedy policy on the grid of starts, which the report is about.
bool is_greedy_grid(const std::string& name);

}  // namespace omentum
