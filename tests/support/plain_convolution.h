#pragma once

#include <cmath>
#include <vector>

#include "core/policy.h"

namespace omentum::test {

/// What the first hidden layer of a network gets, in plain loops: the observation itself, or with
/// convolutions its numbers and the features of its picture. Number is float or double;
/// multiply_add(a, b, sum) = a b + sum.
template <typename Number, typename MultiplyAdd, typename Activation>
std::vector<Number> plain_inputs(const PolicyShape& shape, const NetworkLayout& net,
                                 const std::vector<Number>& p,
                                 const std::vector<Number>& observation, MultiplyAdd multiply_add,
                                 Activation activation) {
  if (!shape.convolution) return observation;
  const auto numbers = static_cast<std::size_t>(shape.numbers());
  std::vector<Number> image;
  for (std::size_t i = numbers; i < observation.size(); ++i) {
    if (shape.picture.channels == 3) {
      image.push_back(observation[i]);
      continue;
    }
    const float id = static_cast<float>(observation[i]) * 6.0F;
    for (int k = 1; k <= 6; ++k)
      image.push_back(std::abs(id - static_cast<float>(k)) < 0.5F ? Number(1) : Number(0));
  }
  const auto layer = [&](const Convolution& c, std::size_t filters, std::size_t bias) {
    const auto count = static_cast<std::size_t>(c.filters);
    std::vector<Number> out;
    for (int y = 0; y < c.side(); ++y) {
      for (int x = 0; x < c.side(); ++x) {
        for (std::size_t f = 0; f < count; ++f) {
          Number sum = p[bias + f];
          std::size_t entry = 0;
          for (int dy = 0; dy < c.kernel; ++dy) {
            for (int dx = 0; dx < c.kernel; ++dx) {
              for (int plane = 0; plane < c.planes; ++plane, ++entry) {
                const int row = y * c.stride + dy, column = x * c.stride + dx;
                const auto at =
                    static_cast<std::size_t>((row * c.size + column) * c.planes + plane);
                sum = multiply_add(image[at], p[filters + entry * count + f], sum);
              }
            }
          }
          out.push_back(activation(sum));
        }
      }
    }
    image = out;
  };
  layer(first_convolution(shape.picture), net.filters1, net.filters1_bias);
  layer(second_convolution(shape.picture), net.filters2, net.filters2_bias);
  std::vector<Number> inputs(observation.begin(),
                             observation.begin() + static_cast<std::ptrdiff_t>(numbers));
  const auto positions = static_cast<float>(second_convolution(shape.picture).positions());
  for (const Number feature : image)
    inputs.push_back(feature * static_cast<Number>(1.0F / positions));
  return inputs;
}

}  // namespace omentum::test
