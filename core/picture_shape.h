#pragma once

namespace omentum {

/// Highest object id of a picture; 0 is the background (sim_worker/camera/camera.h).
inline constexpr int kObjectIds = 6;

/// The picture at the end of an observation: size x size pixels from the top left, row by row, the
/// values of a pixel together.
struct PictureShape {
  int size = 0;  ///< pixels per side; 0 = the observation has no picture
  int channels =
      1;  ///< values per pixel: 1 = object id / kObjectIds; 3 = red, green, blue in [0, 1]

  int values() const { return size * size * channels; }
  /// Inputs of a convolution per pixel: one for each object id but the background, 1 where the
  /// pixel shows it and else 0; or the colours as they are.
  int planes() const { return channels == 1 ? kObjectIds : channels; }
};

}  // namespace omentum
