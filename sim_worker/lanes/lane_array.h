#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>

#include "core/aligned.h"

namespace omentum {

/// Numbers of items in every lane, [item][component][lane] with the lane index fastest, as the lane
/// kernels read and write them. Indices are not checked.
template <typename T>
class LaneArray {
 public:
  LaneArray() = default;

  /// Makes the array anew, all values the same. Returns data(), for the arguments of a kernel.
  T* assign(int items, int components, int lanes, T value = T{0}) {
    components_ = components;
    lanes_ = lanes;
    values_.assign(count(items) * row(), value);
    return data();
  }
  /// assign() where the array is smaller; else it stays as it is.
  T* ensure(int items, int components, int lanes, T value = T{0}) {
    return values_.size() < count(items) * count(components) * count(lanes)
               ? assign(items, components, lanes, value)
               : data();
  }

  bool empty() const { return values_.empty(); }
  std::size_t size() const { return values_.size(); }
  T* data() { return values_.data(); }
  const T* data() const { return values_.data(); }

  T& operator()(int item, int component, int lane) { return values_[at(item, component, lane)]; }
  const T& operator()(int item, int component, int lane) const {
    return values_[at(item, component, lane)];
  }
  /// Of arrays with one component, or the first.
  T& operator()(int item, int lane) { return values_[at(item, 0, lane)]; }
  const T& operator()(int item, int lane) const { return values_[at(item, 0, lane)]; }
  /// Of arrays with one item of one component: a number per lane.
  T& operator[](int lane) { return values_[count(lane)]; }
  const T& operator[](int lane) const { return values_[count(lane)]; }

  /// The first three components of an item.
  Eigen::Vector3d vector(int item, int lane) const {
    const auto number = [&](int k) { return static_cast<double>((*this)(item, k, lane)); };
    return {number(0), number(1), number(2)};
  }
  void set_vector(int item, int lane, const Eigen::Vector3d& v) {
    for (int k = 0; k < 3; ++k) (*this)(item, k, lane) = static_cast<T>(v[k]);
  }

  void fill(T value) { std::fill(values_.begin(), values_.end(), value); }
  void fill_lane(int lane, T value) {
    for (int k = 0; k < in_lane(); ++k) lane_value(k, lane) = value;
  }
  /// Numbers of one lane: items times components, in their order.
  int in_lane() const { return lanes_ == 0 ? 0 : static_cast<int>(values_.size() / count(lanes_)); }
  T& lane_value(int k, int lane) { return values_[count(k) * count(lanes_) + count(lane)]; }
  const T& lane_value(int k, int lane) const {
    return values_[count(k) * count(lanes_) + count(lane)];
  }

 private:
  static std::size_t count(int n) { return static_cast<std::size_t>(n); }
  std::size_t row() const { return count(components_) * count(lanes_); }
  std::size_t at(int item, int component, int lane) const {
    return (count(item) * count(components_) + count(component)) * count(lanes_) + count(lane);
  }

  int components_ = 0, lanes_ = 0;
  AlignedVector<T> values_;
};

}  // namespace omentum
