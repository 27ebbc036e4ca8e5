#include "mismatch/import/rigid.h"

#include <fmt/format.h>

#include <cmath>

#include "core/check.h"
#include "core/constants.h"
#include "core/decompositions.h"
#include "core/table.h"
#include "mismatch/import/units.h"
#include "mismatch/recording/text_table.h"

namespace omentum {
namespace {

// Numbers written with three digits.
constexpr double kRound = 1e-3;

using Eigen::Quaterniond;
using Eigen::Vector3d;

Result<Quaterniond> of_matrix(const Eigen::Matrix3d& R) {
  if (!((R * R.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() <= 10 * kRound))
    return Failure{"no rotation matrix: its rows are not of length 1 and at right angles"};
  if (R.determinant() < 0)
    return Failure{"no rotation matrix: it mirrors, an axis has a wrong sign"};
  return Quaterniond(nearest_rotation(R));
}

}  // namespace

std::size_t numbers_of(pb::RotationForm form) {
  switch (form) {
    case pb::WXYZ:
    case pb::XYZW:
      return 4;
    case pb::MATRIX_BY_ROWS:
    case pb::MATRIX_BY_COLUMNS:
      return 9;
    default:
      return 3;
  }
}

Result<Quaterniond> make_rotation(std::span<const double> n, pb::RotationForm form,
                                  const std::string& axes, bool degrees) {
  OMENTUM_CHECK(n.size() == numbers_of(form), "{} numbers", n.size());
  const double angle_unit = degrees ? kDegree : 1;
  if (form == pb::WXYZ || form == pb::XYZW) {
    const Quaterniond q = form == pb::WXYZ ? Quaterniond(n[0], n[1], n[2], n[3])
                                           : Quaterniond(n[3], n[0], n[1], n[2]);
    if (!(std::fabs(q.norm() - 1) <= kRound))
      return Failure{fmt::format("a quaternion of length {:.6g}, needed 1", q.norm())};
    return q.normalized();
  }
  if (numbers_of(form) == 9) {
    Eigen::Matrix3d R = Eigen::Map<const Eigen::Matrix3d>(n.data());
    if (form == pb::MATRIX_BY_ROWS) R.transposeInPlace();
    return of_matrix(R);
  }
  if (form == pb::ROTATION_VECTOR) {
    const Vector3d turn = angle_unit * Eigen::Map<const Vector3d>(n.data());
    if (turn.norm() == 0) return Quaterniond::Identity();
    return Quaterniond(Eigen::AngleAxisd(turn.norm(), turn.normalized()));
  }
  if (axes.size() != 3 || axes.find_first_not_of("xyz") != std::string::npos)
    return Failure{fmt::format("axes \"{}\", needed three of x y z", shown(axes))};
  Quaterniond q = Quaterniond::Identity();
  for (std::size_t k = 0; k < 3; ++k) {
    const Quaterniond turn(Eigen::AngleAxisd(angle_unit * n[k], Vector3d::Unit(axes[k] - 'x')));
    // About an axis that moves along: applied first; about a fixed one: last.
    q = form == pb::EULER ? q * turn : turn * q;
  }
  return q;
}

Result<RigidFit> fit_rigid(const std::vector<Vector3d>& from, const std::vector<Vector3d>& to) {
  if (from.size() != to.size())
    return Failure{fmt::format("{} points and {}, needed pairs", from.size(), to.size())};
  if (from.size() < 3) return Failure{fmt::format("{} pairs of points, needed 3", from.size())};
  const auto count = static_cast<double>(from.size());
  Vector3d from_mean = Vector3d::Zero(), to_mean = Vector3d::Zero();
  for (std::size_t k = 0; k < from.size(); ++k) {
    from_mean += from[k] / count;
    to_mean += to[k] / count;
  }
  Eigen::Matrix3d across = Eigen::Matrix3d::Zero(), spread = across;
  for (std::size_t k = 0; k < from.size(); ++k) {
    across += (to[k] - to_mean) * (from[k] - from_mean).transpose();
    spread += (from[k] - from_mean) * (from[k] - from_mean).transpose();
  }
  // Squares of lengths: a millionth of the longest side.
  const auto on_a_line = [](const Eigen::Matrix3d& squares) {
    const Vector3d values = singular_values(squares).values;
    return !(values[1] > 1e-12 * values[0]);
  };
  if (on_a_line(spread) || on_a_line(across)) return Failure{"points that lie on one line"};
  RigidFit fit;
  fit.X_TF = Eigen::Isometry3d::Identity();
  fit.X_TF.linear() = nearest_rotation(across);
  fit.X_TF.translation() = to_mean - fit.X_TF.linear() * from_mean;
  double squares = 0;
  for (std::size_t k = 0; k < from.size(); ++k) {
    const double apart = (to[k] - fit.X_TF * from[k]).norm();
    squares += apart * apart;
    fit.largest_m = std::max(fit.largest_m, apart);
  }
  fit.rms_m = std::sqrt(squares / count);
  return fit;
}

namespace {

std::string filled(const std::string& text, const Values& values) {
  Result<std::string> done = fill_in(text, values);
  if (!done) throw_error("transform: {}", done.error());
  return std::move(done).value();
}

std::vector<double> numbers_in(const std::string& text, const Values& values, std::size_t count) {
  Result<std::vector<double>> numbers = parse_numbers(filled(text, values), count);
  if (!numbers) throw_error("transform: {}", numbers.error());
  return std::move(numbers).value();
}

TextTable plain_numbers(const std::string& path, std::size_t columns) {
  TextFormat format;
  format.header = false;
  format.comment = "#";
  TextTable table = TextTable::read(path, format);
  if (table.names().size() != columns)
    throw_error("{}: {} numbers in a row, needed {}", path, table.names().size(), columns);
  return table;
}

std::vector<Vector3d> read_points(const std::string& path, double factor) {
  const TextTable table = plain_numbers(path, 3);
  std::vector<Vector3d> points;
  for (std::size_t row = 0; row < table.rows(); ++row)
    points.push_back(factor *
                     Vector3d(table.number(row, 0), table.number(row, 1), table.number(row, 2)));
  return points;
}

Eigen::Isometry3d read_matrix(const std::string& path) {
  const TextTable table = plain_numbers(path, 4);
  if (table.rows() != 3 && table.rows() != 4)
    throw_error("{}: {} rows, needed 3 or 4", path, table.rows());
  Eigen::Matrix3d R;
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  for (std::size_t row = 0; row < 3; ++row) {
    const auto i = static_cast<Eigen::Index>(row);
    for (std::size_t k = 0; k < 3; ++k) R(i, static_cast<Eigen::Index>(k)) = table.number(row, k);
    X.translation()[i] = table.number(row, 3);
  }
  const Result<Quaterniond> turn = of_matrix(R);
  if (!turn) throw_error("{}: {}", path, turn.error());
  X.linear() = turn.value().toRotationMatrix();
  return X;
}

}  // namespace

Eigen::Isometry3d make_transform(const google::protobuf::RepeatedPtrField<pb::TransformMap>& maps,
                                 const std::string& folder, const Values& values,
                                 std::vector<std::string>& notes) {
  Eigen::Isometry3d all = Eigen::Isometry3d::Identity();
  for (const pb::TransformMap& map : maps) {
    Eigen::Isometry3d one = Eigen::Isometry3d::Identity();
    if (map.has_fit()) {
      const Result<UnitFactor> unit = find_unit(map.fit().unit());
      if (!unit || unit.value().si != "m")
        throw_error("transform.fit.unit: \"{}\", needed a length", map.fit().unit());
      const std::string from = folder + "/" + filled(map.fit().from(), values);
      const Result<RigidFit> fit = fit_rigid(
          read_points(from, unit.value().factor),
          read_points(folder + "/" + filled(map.fit().to(), values), unit.value().factor));
      if (!fit) throw_error("{}: {}", from, fit.error());
      one = fit.value().X_TF;
      notes.push_back(fmt::format("{}: fitted transform leaves {:.3g} mm rms, {:.3g} mm at most",
                                  from, 1e3 * fit.value().rms_m, 1e3 * fit.value().largest_m));
    } else if (map.has_matrix_file()) {
      one = read_matrix(folder + "/" + filled(map.matrix_file(), values));
    } else {
      if (map.has_rotation()) {
        const auto numbers = numbers_in(map.rotation(), values, numbers_of(map.form()));
        const auto turn = make_rotation(numbers, map.form(), map.axes(), map.degrees());
        if (!turn) throw_error("transform.rotation: {}", turn.error());
        one.linear() = turn.value().toRotationMatrix();
      }
      if (map.has_p_m()) {
        const auto p = numbers_in(map.p_m(), values, 3);
        one.translation() = Vector3d(p[0], p[1], p[2]);
      }
    }
    if (map.inverse()) one = one.inverse();
    all = one * all;
  }
  return all;
}

}  // namespace omentum
