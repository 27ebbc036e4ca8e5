#pragma once

#include <google/protobuf/message.h>

#include <cstddef>
#include <string>
#include <vector>

#include "core/check.h"

/// Numbers and rows of numbers in fields of protobuf messages, by the fields' names. A name that a
/// message lacks, and a field of a type not listed here, is a bug and aborts.
namespace omentum::message_rows {

using google::protobuf::FieldDescriptor;
using google::protobuf::Message;

/// The field of that name; aborts where the message has none.
inline const FieldDescriptor& field_of(const Message& message, const char* name) {
  const FieldDescriptor* field = message.GetDescriptor()->FindFieldByName(name);
  OMENTUM_CHECK(field != nullptr, "{} is no field of the recording", name);
  return *field;
}

/// Calls use(getter, setter) with what accesses a number field of its type: float, double, uint32,
/// uint64 or bool, else it aborts.
template <typename Use>
auto with_access(const FieldDescriptor& field, Use&& use) {
  using Access = google::protobuf::Reflection;
  switch (field.cpp_type()) {
    case FieldDescriptor::CPPTYPE_FLOAT:
      return use(&Access::GetFloat, &Access::SetFloat);
    case FieldDescriptor::CPPTYPE_DOUBLE:
      return use(&Access::GetDouble, &Access::SetDouble);
    case FieldDescriptor::CPPTYPE_UINT32:
      return use(&Access::GetUInt32, &Access::SetUInt32);
    case FieldDescriptor::CPPTYPE_UINT64:
      return use(&Access::GetUInt64, &Access::SetUInt64);
    default:
      OMENTUM_CHECK(field.cpp_type() == FieldDescriptor::CPPTYPE_BOOL, "{} is of another type",
                    field.full_name());
      return use(&Access::GetBool, &Access::SetBool);
  }
}

template <typename T>
void put_one(Message& message, const char* name, T value) {
  const FieldDescriptor& field = field_of(message, name);
  const google::protobuf::Reflection& access = *message.GetReflection();
  with_access(field, [&](auto get, auto set) {
    using Stored = decltype((access.*get)(message, &field));
    (access.*set)(&message, &field, static_cast<Stored>(value));
  });
}

template <typename T>
T get_one(const Message& message, const char* name) {
  const FieldDescriptor& field = field_of(message, name);
  return with_access(field, [&](auto get, auto /*set*/) {
    return static_cast<T>((message.GetReflection()->*get)(message, &field));
  });
}

/// Writes `width` entries from `row` to the field: one number, numbers, or bytes.
template <typename T>
void put_row(Message& message, const char* name, const T* row, std::size_t width) {
  const FieldDescriptor& field = field_of(message, name);
  const google::protobuf::Reflection& access = *message.GetReflection();
  if (field.type() == FieldDescriptor::TYPE_BYTES) {
    access.SetString(&message, &field, std::string(row, row + width));
  } else if (!field.is_repeated()) {
    put_one(message, name, *row);
  } else {
    for (std::size_t k = 0; k < width; ++k)
      access.AddFloat(&message, &field, static_cast<float>(row[k]));
  }
}

/// Entries that the field of a message holds, 0 = absent.
inline std::size_t width_of(const Message& message, const char* name) {
  const FieldDescriptor& field = field_of(message, name);
  const google::protobuf::Reflection& access = *message.GetReflection();
  if (field.is_repeated()) return static_cast<std::size_t>(access.FieldSize(message, &field));
  if (!access.HasField(message, &field)) return 0;
  return field.type() == FieldDescriptor::TYPE_BYTES ? access.GetString(message, &field).size() : 1;
}

/// Appends the entries that the field holds to an array.
template <typename T>
void take_row(const Message& message, const char* name, std::vector<T>& array) {
  const FieldDescriptor& field = field_of(message, name);
  const google::protobuf::Reflection& access = *message.GetReflection();
  if (field.type() == FieldDescriptor::TYPE_BYTES) {
    for (const char byte : access.GetString(message, &field)) array.push_back(static_cast<T>(byte));
  } else if (!field.is_repeated()) {
    if (access.HasField(message, &field)) array.push_back(get_one<T>(message, name));
  } else {
    for (int k = 0; k < access.FieldSize(message, &field); ++k)
      array.push_back(static_cast<T>(access.GetRepeatedFloat(message, &field, k)));
  }
}

}  // namespace omentum::message_rows
