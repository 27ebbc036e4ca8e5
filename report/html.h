#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace omentum {

/// Text safe inside elements and double-quoted attributes; bytes that HTML forbids become '?'.
std::string escape_html(std::string_view text);

std::string base64(std::string_view bytes);

/// A figure of the run in one glance: large value, small words.
struct Tile {
  std::string value, label, note;
};
std::string make_tiles(const std::vector<Tile>& tiles);

/// A table; cells are text, the first row is the head. Columns listed in `numeric` are
/// right-aligned.
std::string make_table(const std::vector<std::vector<std::string>>& rows,
                       const std::vector<std::size_t>& numeric);

/// A section with an anchor; `content` is markup.
struct Section {
  std::string id, title, lead;  ///< lead: one or two sentences of text under the title
  std::string content;
};

/// The whole document: style, header, contents, sections, script. Refers to nothing outside itself.
/// `footer` is markup under everything.
std::string make_page(const std::string& title, const std::string& subtitle,
                      const std::string& tiles, const std::vector<Section>& sections,
                      const std::string& script, const std::string& footer);

}  // namespace omentum
