#include "report/html.h"

#include <fmt/core.h>
#include <openssl/evp.h>

#include <algorithm>

namespace omentum {
namespace {

constexpr const char* kStyle = R"css(
:root {
  color-scheme: light dark;
  --paper: #fbfaf7; --card: #ffffff; --ink: #1c2326; --muted: #667176; --rule: #e2e0d8; --grid: #ecebe4;
  --empty: #efeee8; --accent: #1f6f78; --mark: #c2410c;
  --s1: #1f6f78; --s2: #c2410c; --s3: #6d5bb3; --s4: #9a7b12; --s5: #3f7d3a; --s6: #a33a6b; --company: #b4b9ba;
  --shadow: 0 1px 2px rgb(20 30 30 / 6%), 0 4px 16px rgb(20 30 30 / 5%);
}
@media (prefers-color-scheme: dark) {
  :root {
    --paper: #14181a; --card: #1b2023; --ink: #e6e8e6; --muted: #98a3a6; --rule: #2c3336; --grid: #283033;
    --empty: #252b2e; --accent: #6cc3c9; --mark: #fb923c;
    --s1: #5fc0c8; --s2: #f59b5c; --s3: #a99be8; --s4: #d9b94f; --s5: #8fc98a; --s6: #e58bb4; --company: #545e61;
    --shadow: none;
  }
}
* { box-sizing: border-box; }
html { scroll-behavior: smooth; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.55 "Inter", "Source Sans 3", "Segoe UI", "Helvetica Neue", "Noto Sans", "DejaVu Sans", Arial, sans-serif; }
main, header.top, footer { max-width: 1280px; margin: 0 auto; padding: 0 28px; }
header.top { padding-top: 48px; }
h1 { font-size: 34px; line-height: 1.15; letter-spacing: -0.015em; margin: 0 0 6px; font-weight: 650; }
.subtitle { color: var(--muted); margin: 0 0 26px; overflow-wrap: anywhere; }
nav { display: flex; flex-wrap: wrap; gap: 6px 20px; padding: 12px 0; border-top: 1px solid var(--rule);
  border-bottom: 1px solid var(--rule); font-size: 14px; }
nav a { color: var(--accent); text-decoration: none; }
nav a:hover { text-decoration: underline; }
section { margin: 52px 0; }
h2 { font-size: 22px; letter-spacing: -0.01em; margin: 0 0 4px; font-weight: 640; }
h2 + .row, h2 + .card, h2 + details { margin-top: 18px; }
.row + .card, .card + .card, .card + .row { margin-top: 20px; }
.row > .card + .card { margin-top: 0; }
h3 { font-size: 15px; margin: 0 0 8px; font-weight: 640; }
.lead { color: var(--muted); max-width: 74ch; margin: 0 0 20px; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 14px; margin: 0 0 30px; }
.tile { background: var(--card); border: 1px solid var(--rule); border-radius: 10px; padding: 14px 16px; box-shadow: var(--shadow); }
.tile .value { font-size: 27px; font-weight: 640; letter-spacing: -0.02em; font-variant-numeric: tabular-nums; line-height: 1.2; }
.tile .name { font-size: 13.5px; }
.tile .note { font-size: 12.5px; color: var(--muted); }
.row + h3 { margin-top: 28px; }
.row { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 372px), 1fr)); gap: 20px; align-items: start; }
.card.half { max-width: 500px; }
.card { background: var(--card); border: 1px solid var(--rule); border-radius: 10px; padding: 18px 20px; box-shadow: var(--shadow); min-width: 0; }
.missing { color: var(--muted); border: 1px dashed var(--rule); border-radius: 10px; padding: 14px 18px; font-size: 14.5px; }
svg.plot { display: block; width: 100%; height: auto; font-family: inherit; }
figure.plot { margin: 0; }
figure.plot figcaption { font-size: 15px; font-weight: 640; margin: 0 0 6px; }
.legend { display: flex; flex-wrap: wrap; gap: 2px 18px; margin: 0 0 6px; font-size: 13px; color: var(--muted); }
svg.key { display: inline-block; margin-right: 7px; vertical-align: -1px; }
svg .label, svg .note { font-size: 12.5px; fill: var(--muted); }
svg .tick { font-size: 12px; fill: var(--muted); font-variant-numeric: tabular-nums; }
svg .cell { font-size: 12.5px; font-variant-numeric: tabular-nums; }
svg .grid { stroke: var(--grid); stroke-width: 1; }
svg .axis { stroke: var(--muted); stroke-width: 1; }
svg .milestone { stroke: var(--muted); stroke-width: 1; stroke-dasharray: 4 4; }
svg .series { fill: none; stroke-width: 2; stroke-linejoin: round; }
svg .company { fill: none; stroke: var(--company); stroke-width: 1; }
svg .s1 { stroke: var(--s1); } svg .s2 { stroke: var(--s2); } svg .s3 { stroke: var(--s3); }
svg .s4 { stroke: var(--s4); } svg .s5 { stroke: var(--s5); } svg .s6 { stroke: var(--s6); }
svg .band { opacity: 0.18; stroke: none; }
svg .b1 { fill: var(--s1); } svg .b2 { fill: var(--s2); } svg .b3 { fill: var(--s3); }
svg .b4 { fill: var(--s4); } svg .b5 { fill: var(--s5); } svg .b6 { fill: var(--s6); }
svg .mark { fill: none; stroke: var(--mark); stroke-width: 2.5; }
svg .best { fill: none; stroke: var(--mark); stroke-width: 2.5; }
svg .bestnote { font-size: 12.5px; font-weight: 640; fill: var(--mark); paint-order: stroke; stroke: var(--card); stroke-width: 4px; stroke-linejoin: round; }
.pictures { display: grid; grid-template-columns: repeat(3, 1fr); gap: 10px; }
.pictures figure { margin: 0; }
.pictures img { width: 100%; height: auto; display: block; border-radius: 8px; background: #0e1013; }
.pictures figcaption { font-size: 13px; color: var(--muted); padding: 6px 2px 0; }
.episode { margin: 0 0 26px; }
table { border-collapse: collapse; width: 100%; font-size: 14.5px; }
.scroll { overflow-x: auto; }
.scroll:focus-visible, .pane canvas:focus-visible { outline: 3px solid var(--accent); outline-offset: -3px; }
.scrolls { margin: 0 0 6px; font-size: 13px; color: var(--muted); }
th { text-align: left; font-weight: 600; color: var(--muted); font-size: 13px; }
th, td { padding: 7px 14px 7px 0; border-bottom: 1px solid var(--rule); vertical-align: top; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; }
td.number { white-space: nowrap; }
details { background: var(--card); border: 1px solid var(--rule); border-radius: 10px; padding: 12px 18px; }
summary { cursor: pointer; font-weight: 600; }
pre { white-space: pre-wrap; overflow-wrap: anywhere; font: 12.5px/1.5 ui-monospace, "JetBrains Mono", "DejaVu Sans Mono", Menlo, monospace; margin: 12px 0 4px; }
.replay { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 420px), 1fr)); gap: 16px; }
.pane { position: relative; border-radius: 10px; overflow: hidden; background: #15181c; border: 1px solid var(--rule); }
.pane canvas { width: 100%; aspect-ratio: 4 / 3; display: block; cursor: grab; touch-action: none; }
.pane canvas:active { cursor: grabbing; }
.pane .over { position: absolute; left: 12px; right: 12px; top: 10px; display: flex; flex-wrap: wrap; justify-content: space-between; gap: 4px 10px;
  color: #eef1f0; font-size: 13px; pointer-events: none; text-shadow: 0 1px 3px #000; }
.pane select { pointer-events: auto; background: rgb(20 24 28 / 75%); color: #eef1f0; border: 1px solid #4a5257; border-radius: 6px;
  font: inherit; padding: 2px 6px; max-width: 100%; }
.pane .state { font-variant-numeric: tabular-nums; white-space: nowrap; }
.controls { display: flex; gap: 14px; align-items: center; margin: 14px 0 0; flex-wrap: wrap; font-size: 14px; }
.controls input[type=range] { flex: 1; min-width: 180px; accent-color: var(--accent); }
.controls button { font: inherit; background: var(--card); color: var(--ink); border: 1px solid var(--rule); border-radius: 8px;
  padding: 6px 16px; cursor: pointer; min-width: 84px; }
.controls button:hover { border-color: var(--accent); }
.controls .time { font-variant-numeric: tabular-nums; min-width: 74px; text-align: right; }
.hint { color: var(--muted); font-size: 13px; margin: 8px 0 0; }
footer { color: var(--muted); font-size: 13px; padding-top: 12px; padding-bottom: 60px; border-top: 1px solid var(--rule); }
@media (max-width: 700px) {
  .pictures { grid-template-columns: 1fr; } h1 { font-size: 27px; overflow-wrap: anywhere; }
  main, header.top, footer { padding: 0 12px; } .card { padding: 14px 14px; } section { margin: 40px 0; }
}
@media print { nav, .controls, #replay { display: none; } section { break-inside: avoid; } }
)css";

// What is wider than its place says so, and can be reached and scrolled by keyboard.
constexpr const char* kScrollScript = R"js("use strict";
(function () {
  function tell() {
    for (const box of document.querySelectorAll(".scroll")) {
      const wide = box.scrollWidth > box.clientWidth + 1;
      const before = box.previousElementSibling;
      const note = before && before.classList.contains("scrolls") ? before : null;
      if (wide && !note) {
        const text = document.createElement("p");
        text.className = "scrolls";
        text.textContent = "\u2194 wider than the page: scroll sideways";
        box.before(text);
      } else if (!wide && note) {
        note.remove();
      }
      box.tabIndex = wide ? 0 : -1;
      box.setAttribute("role", "region");
      box.setAttribute("aria-label", wide ? "scrolls sideways" : "table or plot");
    }
  }
  tell();
  window.addEventListener("resize", tell);
})();
)js";

}  // namespace

std::string escape_html(std::string_view text) {
  std::string out;
  out.reserve(text.size());
  for (const char c : text) {
    switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      default: {
        const auto byte = static_cast<unsigned char>(c);
        out += (byte < 32 && c != '\n' && c != '\t') || byte == 127 ? '?' : c;
      }
    }
  }
  return out;
}

std::string base64(std::string_view bytes) {
  std::string out((bytes.size() + 2) / 3 * 4 + 1, '\0');
  const auto* from = reinterpret_cast<const unsigned char*>(bytes.data());
  EVP_EncodeBlock(reinterpret_cast<unsigned char*>(out.data()), from,
                  static_cast<int>(bytes.size()));
  out.pop_back();  // the zero that ends it
  return out;
}

std::string make_tiles(const std::vector<Tile>& tiles) {
  std::string html = "<div class=\"tiles\">\n";
  for (const Tile& tile : tiles) {
    html += fmt::format(
        "<div class=\"tile\"><div class=\"value\">{}</div><div class=\"name\">{}</div><div "
        "class=\"note\">{}</div></div>\n",
        escape_html(tile.value), escape_html(tile.label), escape_html(tile.note));
  }
  return html + "</div>\n";
}

std::string make_table(const std::vector<std::vector<std::string>>& rows,
                       const std::vector<std::size_t>& numeric) {
  std::string html = "<div class=\"scroll\"><table>\n";
  for (std::size_t r = 0; r < rows.size(); ++r) {
    const char* tag = r == 0 ? "th" : "td";
    html += "<tr>";
    for (std::size_t c = 0; c < rows[r].size(); ++c) {
      const bool number = std::find(numeric.begin(), numeric.end(), c) != numeric.end();
      html += fmt::format("<{0}{1}>{2}</{0}>", tag, number ? " class=\"number\"" : "",
                          escape_html(rows[r][c]));
    }
    html += "</tr>\n";
  }
  return html + "</table></div>\n";
}

std::string make_page(const std::string& title, const std::string& subtitle,
                      const std::string& tiles, const std::vector<Section>& sections,
                      const std::string& script, const std::string& footer) {
  std::string html = fmt::format(
      "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n"
      "<link rel=\"icon\" href=\"data:,\">\n<title>{}</title>\n<style>{}</style>\n</head>\n<body>\n"
      "<header class=\"top\">\n<h1>{}</h1>\n<p class=\"subtitle\">{}</p>\n{}<nav>",
      escape_html(title), kStyle, escape_html(title), escape_html(subtitle), tiles);
  for (const Section& section : sections) {
    html += fmt::format("<a href=\"#{}\">{}</a>", section.id, escape_html(section.title));
  }
  html += "</nav>\n</header>\n<main>\n";
  for (const Section& section : sections) {
    html +=
        fmt::format("<section id=\"{}\">\n<h2>{}</h2>\n", section.id, escape_html(section.title));
    if (!section.lead.empty())
      html += fmt::format("<p class=\"lead\">{}</p>\n", escape_html(section.lead));
    html += section.content + "</section>\n";
  }
  html += "</main>\n<footer>" + footer + "</footer>\n";
  html += fmt::format("<script>\n{}</script>\n", kScrollScript);
  if (!script.empty()) html += "<script>\n" + script + "</script>\n";
  return html + "</body>\n</html>\n";
}

}  // namespace omentum
