#include <cstddef>
#include <cstdint>
#include <string>

#include "core/csv.h"
#include "core/evaluation_table.h"

// Any text gives a table whose rows are whole, or one line that names the file; so does what is
// read of it as an evaluation.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  const omentum::Result<omentum::CsvTable> read = omentum::parse_csv("fuzz", text);
  if (!read) {
    if (!read.error().starts_with("fuzz:") || read.error().find('\n') != std::string::npos)
      __builtin_trap();
    return 0;
  }
  const omentum::CsvTable& table = read.value();
  if (table.header.empty() || table.lines.size() != table.rows.size()) __builtin_trap();
  std::size_t line = table.header_line;
  for (std::size_t row = 0; row < table.rows.size(); ++row) {
    if (table.rows[row].size() != table.header.size() || table.lines[row] <= line) __builtin_trap();
    line = table.lines[row];
  }
  const auto rows = omentum::read_evaluation(table);
  if (!rows && !rows.error().starts_with("fuzz:")) __builtin_trap();
  if (rows && omentum::figures_of(rows.value()).starts != table.rows.size()) __builtin_trap();
  if (!table.require_numbers()) return 0;
  for (const omentum::CsvCell& cell : table.header) {
    if (table.numbers(cell.text).size() != table.rows.size()) __builtin_trap();
  }
  return 0;
}
