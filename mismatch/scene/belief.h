#pragma once

#include <Eigen/Core>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace omentum {

/// A weight that is said to hang on the body.
struct BelievedMass {
  std::optional<double> kg;
  std::optional<Eigen::Vector3d> p_B;  ///< where [m]
};

/// What scene_believed.txt says, before it is a scene: keys with their numbers in SI or their
/// words.
class Belief {
 public:
  explicit Belief(std::string name) : name_(std::move(name)) {}

  /// Total over any bytes; fails with one line, `name`:line and what was expected.
  Result<void> read(std::string_view text);
  double number(const std::string& key, double otherwise) const {
    const auto found = numbers_.find(key);
    return found == numbers_.end() ? otherwise : found->second.front();
  }
  /// Absent where one number stands for it.
  std::optional<Eigen::Vector3d> vector(const std::string& key) const {
    const auto found = numbers_.find(key);
    if (found == numbers_.end()) return std::nullopt;
    if (found->second.size() < 3) return std::nullopt;
    return Eigen::Vector3d(found->second[0], found->second[1], found->second[2]);
  }
  bool has(const std::string& key) const { return numbers_.count(key) + texts_.count(key) > 0; }
  std::string text(const std::string& key) const {
    const auto found = texts_.find(key);
    return found == texts_.end() ? "" : found->second;
  }
  /// "name:line: key"
  std::string place(const std::string& key) const {
    const auto found = lines_.find(key);
    return found == lines_.end() ? name_ : fmt::format("{}:{}: {}", name_, found->second, key);
  }
  /// Pinch points by their number, in the frame of the sheet and in W [m].
  const std::map<int, Eigen::Vector3d>& pinch_sheet() const { return pinch_sheet_; }
  const std::map<int, Eigen::Vector3d>& pinch_W() const { return pinch_W_; }
  /// Weights on the body by their number.
  const std::map<int, BelievedMass>& masses() const { return masses_; }
  /// Keys that none are.
  const std::vector<std::string>& unknown() const { return unknown_; }

 private:
  Result<std::vector<double>> parse_numbers(std::size_t line, std::string_view key,
                                            std::string_view value, int least, int most) const;
  Result<void> take(std::size_t line, const std::string& key, std::string_view value);
  /// Keys with a number in their name; false: it is none of them.
  Result<bool> take_numbered(std::size_t line, const std::string& key, std::string_view value);

  std::string name_;
  std::map<std::string, std::vector<double>> numbers_;
  std::map<std::string, std::string> texts_;
  std::map<std::string, std::size_t> lines_;
  std::map<int, Eigen::Vector3d> pinch_sheet_, pinch_W_;
  std::map<int, BelievedMass> masses_;
  std::vector<std::string> unknown_;
};

/// The first numbers before units of a text such as "2 mm, 0.5 deg", in SI; 0: none. Of a range
/// such as "0.5-1.5 mm" its end counts.
struct StatedUncertainty {
  double metres = 0, radians = 0;
};
StatedUncertainty uncertainty_in(std::string_view text);

}  // namespace omentum
