#include "mismatch/intake/canvas.h"

#include <algorithm>
#include <cctype>
#include <cmath>

namespace omentum {
namespace {

/// Five rows of three pixels, a digit 0 ... 7 each.
std::string_view glyph_of(char c) {
  switch (std::toupper(static_cast<unsigned char>(c))) {
    case '0':
      return "75557";
    case '1':
      return "26227";
    case '2':
      return "71747";
    case '3':
      return "71317";
    case '4':
      return "55711";
    case '5':
      return "74717";
    case '6':
      return "74757";
    case '7':
      return "71122";
    case '8':
      return "75757";
    case '9':
      return "75717";
    case 'A':
      return "25755";
    case 'B':
      return "65656";
    case 'C':
      return "34443";
    case 'D':
      return "65556";
    case 'E':
      return "74647";
    case 'F':
      return "74644";
    case 'G':
      return "34553";
    case 'H':
      return "55755";
    case 'I':
      return "72227";
    case 'J':
      return "11152";
    case 'K':
      return "55655";
    case 'L':
      return "44447";
    case 'M':
      return "57755";
    case 'N':
      return "65555";
    case 'O':
      return "25552";
    case 'P':
      return "65644";
    case 'Q':
      return "25563";
    case 'R':
      return "65655";
    case 'S':
      return "34216";
    case 'T':
      return "72222";
    case 'U':
      return "55557";
    case 'V':
      return "55552";
    case 'W':
      return "55775";
    case 'X':
      return "55255";
    case 'Y':
      return "55222";
    case 'Z':
      return "71247";
    case '.':
      return "00002";
    case ',':
      return "00024";
    case '-':
      return "00700";
    case '+':
      return "02720";
    case '/':
      return "11244";
    case '_':
      return "00007";
    case ':':
      return "02020";
    case '(':
      return "24442";
    case ')':
      return "21112";
    case '%':
      return "51245";
    case '=':
      return "07070";
    case '<':
      return "12421";
    case '>':
      return "42124";
    default:
      return "00000";
  }
}

}  // namespace

Canvas::Canvas(int width, int height, Colour background) {
  picture_.width = static_cast<std::uint32_t>(width);
  picture_.height = static_cast<std::uint32_t>(height);
  picture_.rgb.resize(3 * std::size_t{picture_.width} * picture_.height);
  box(0, 0, width, height, background);
}

void Canvas::pixel(int x, int y, Colour colour) {
  if (x < 0 || y < 0 || x >= width() || y >= height()) return;
  const std::size_t at =
      3 * (static_cast<std::size_t>(y) * picture_.width + static_cast<std::size_t>(x));
  std::copy(colour.begin(), colour.end(), picture_.rgb.begin() + static_cast<std::ptrdiff_t>(at));
}

void Canvas::box(int x, int y, int width, int height, Colour colour) {
  for (int v = y; v < y + height; ++v) {
    for (int u = x; u < x + width; ++u) pixel(u, v, colour);
  }
}

void Canvas::line(double x0, double y0, double x1, double y1, Colour colour) {
  const double length = std::max(std::fabs(x1 - x0), std::fabs(y1 - y0));
  if (!(length < 1e5)) return;
  const int steps = std::max(1, static_cast<int>(std::ceil(length)));
  for (int k = 0; k <= steps; ++k) {
    const double share = static_cast<double>(k) / steps;
    pixel(static_cast<int>(std::lround(x0 + share * (x1 - x0))),
          static_cast<int>(std::lround(y0 + share * (y1 - y0))), colour);
  }
}

void Canvas::text(int x, int y, std::string_view text, Colour colour) {
  constexpr int kDot = 2, kRows = 5, kColumns = 3, kPitch = kDot * (kColumns + 1);
  for (const char c : text) {
    const std::string_view glyph = glyph_of(c);
    for (int row = 0; row < kRows; ++row) {
      const int bits = glyph[static_cast<std::size_t>(row)] - '0';
      for (int column = 0; column < kColumns; ++column) {
        if ((bits >> (kColumns - 1 - column) & 1) != 0)
          box(x + kDot * column, y + kDot * row, kDot, kDot, colour);
      }
    }
    x += kPitch;
  }
}

void Canvas::picture(int x, int y, int width, int height, const Picture& picture) {
  const double scale = std::max(static_cast<double>(picture.width) / width,
                                static_cast<double>(picture.height) / height);
  if (!(scale > 0)) return;
  const int w = static_cast<int>(picture.width / scale),
            h = static_cast<int>(picture.height / scale);
  for (int v = 0; v < h; ++v) {
    for (int u = 0; u < w; ++u) {
      const auto column = std::min(static_cast<std::uint32_t>(u * scale), picture.width - 1);
      const auto row = std::min(static_cast<std::uint32_t>(v * scale), picture.height - 1);
      const std::uint8_t* from =
          picture.rgb.data() + 3 * (std::size_t{row} * picture.width + column);
      pixel(x + (width - w) / 2 + u, y + (height - h) / 2 + v, {from[0], from[1], from[2]});
    }
  }
}

std::string Canvas::png() const {
  const std::size_t line = 3 * std::size_t{picture_.width};
  std::string rows;
  for (std::size_t v = 0; v < picture_.height; ++v) {
    rows.push_back('\0');
    rows.append(reinterpret_cast<const char*>(picture_.rgb.data()) + v * line, line);
  }
  constexpr int kLevel = 6;
  return encode_png(picture_.width, picture_.height, 8, 3, rows, kLevel);
}

Colour height_colour(double share) {
  const double s = std::clamp(share, 0.0, 1.0);
  const auto mix = [&](double low, double middle, double high) {
    const double v =
        s < 0.5 ? low + 2 * s * (middle - low) : middle + (2 * s - 1) * (high - middle);
    return static_cast<std::uint8_t>(std::lround(v));
  };
  return {mix(50, 30, 245), mix(70, 160, 225), mix(190, 130, 60)};
}

}  // namespace omentum
