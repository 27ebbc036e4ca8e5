// Tissue::step runs the stages of every model in their order.
#include <gtest/gtest.h>

#include <string>

#include "core/aligned.h"
#include "sim_worker/tissue/tissue.h"

namespace omentum {
namespace {

struct ThreeSubsteps : TissueModel {
  std::unique_ptr<Tissue<float>> make_tissue(const LaneKernel<float>&) const override {
    return nullptr;
  }
  std::unique_ptr<Tissue<double>> make_tissue(const LaneKernel<double>&) const override {
    return nullptr;
  }
  std::uint32_t substeps() const override { return 3; }
};

/// Writes down what is asked of it.
class Listener final : public Tissue<double> {
 public:
  const TissueModel& model() const override { return model_; }
  int lanes() const override { return 1; }
  int particles() const override { return 0; }
  const LaneKernel<double>& kernel() const override { return f64x1(); }
  void reset(int, const Eigen::Vector3d&) override {}
  void set_parameters(int, const LaneParameters&) override {}
  void begin_step(std::span<const ToolMotion> motion) override {
    heard += "step " + std::to_string(motion.size());
  }
  void begin_substep(std::span<const ToolMotion>, int substep) override {
    heard += ", begin " + std::to_string(substep);
  }
  void solve_substep() override { heard += " solve"; }
  void end_substep(bool last) override { heard += last ? " last" : " end"; }
  void hold(int, const Eigen::Vector3d&, double, bool) override {}
  void release(int) override {}
  std::span<const std::int32_t> held(int) const override { return {}; }
  void shift_held(int, const Eigen::Vector3d&) override {}
  Eigen::Vector3d held_force(int) const override { return Eigen::Vector3d::Zero(); }
  Eigen::Vector3d position(int, int) const override { return Eigen::Vector3d::Zero(); }
  Eigen::Vector3d velocity(int, int) const override { return Eigen::Vector3d::Zero(); }
  void set_position(int, int, const Eigen::Vector3d&) override {}
  void set_velocity(int, int, const Eigen::Vector3d&) override {}
  void find_nearest(std::span<const Eigen::Vector3d>, std::span<Nearest>) const override {}
  const double* surface_positions() override { return nullptr; }
  int surface_vertices() const override { return 0; }
  bool healthy(int) const override { return true; }
  void save(int, Bytes&) const override {}
  Result<std::size_t> load(int, std::span<const std::byte>) override { return std::size_t{0}; }
  std::uint64_t hash(int) const override { return 0; }

  std::string heard;

 private:
  ThreeSubsteps model_;
};

TEST(TissueStep, RunsTheStagesOfEverySubstepInOrder) {
  Listener tissue;
  const ToolMotion still;
  tissue.step({&still, 1});
  EXPECT_EQ(tissue.heard, "step 1, begin 0 solve end, begin 1 solve end, begin 2 solve last");
}

TEST(TissueStep, AnotherNumberOfMotionsThanLanesIsABug) {
  Listener tissue;
  const ToolMotion motion[2];
  EXPECT_DEATH(tissue.step(motion), "lanes");
}

}  // namespace
}  // namespace omentum
