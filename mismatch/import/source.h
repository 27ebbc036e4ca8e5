#pragma once

#include <Eigen/Geometry>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "mismatch/import/file_pattern.h"
#include "mismatch/recording/recording.h"
#include "mismatch/recording/text_table.h"
#include "proto/import_map.pb.h"

namespace omentum {

/// Rows of a table that are samples of one recording.
struct RowBlock {
  Values values;  ///< of the split: cells, parameters, {block}
  std::vector<std::size_t> rows;
};

/// A table of text of a source. All throw Error.
TextTable read_source_table(const pb::SourceMap& source, const std::string& path);

/// Named values of a source: those of the head of its table and of other files.
void add_values(const pb::SourceMap& source, const std::string& folder, const TextTable* table,
                Values& values);

/// Rows that the filters leave, as one block for every recording; of a source without split one.
std::vector<RowBlock> split_rows(const pb::SourceMap& source, const TextTable& table);

/// Times of the rows [ns]. `earlier`: times of the sources before, by name.
std::vector<std::int64_t> row_times(
    const pb::SourceMap& source, const TextTable* table, const std::vector<std::size_t>& rows,
    const Values& values, const std::map<std::string, std::vector<std::int64_t>>& earlier);

/// Channels of the rows of a table, in the frame of the source.
void add_columns(const pb::SourceMap& source, const TextTable& table,
                 const std::vector<std::size_t>& rows, const std::vector<std::int64_t>& times,
                 const Values& values, std::map<std::string, Series>& found);

/// Normalises, turns into W by X_WF and moves them to the recording; a channel that another source
/// gave already is refused.
void add_series(const std::string& path, const Eigen::Isometry3d& X_WF,
                std::map<std::string, Series> found, Recording& recording);

/// Table of a recording folder that has a column; empty where none has.
std::string_view table_of_column(std::string_view column);

}  // namespace omentum
