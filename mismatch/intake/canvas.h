#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>

#include "mismatch/recording/png_image.h"

namespace omentum {

using Colour = std::array<std::uint8_t, 3>;

/// A picture that is drawn on: pixels from the top left; what lies outside is left out.
class Canvas {
 public:
  Canvas(int width, int height, Colour background);
  int width() const { return static_cast<int>(picture_.width); }
  int height() const { return static_cast<int>(picture_.height); }
  void pixel(int x, int y, Colour colour);
  void box(int x, int y, int width, int height, Colour colour);
  void line(double x0, double y0, double x1, double y1, Colour colour);
  /// Capitals, digits and . , - + / _ : ( ) % = < >, 8 pixels wide and 12 high each; others as a
  /// blank. (x, y) is the upper left corner.
  void text(int x, int y, std::string_view text, Colour colour);
  /// A picture scaled to fit into a box, in its middle.
  void picture(int x, int y, int width, int height, const Picture& picture);
  std::string png() const;

 private:
  Picture picture_;
};

/// Blue, green, yellow for 0 ... 1.
Colour height_colour(double share);

}  // namespace omentum
