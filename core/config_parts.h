#pragma once

#include <google/protobuf/text_format.h>

#include <memory>
#include <string>

#include "proto/config.pb.h"

/// What the files of the configuration share: text to messages, one override. For core/config*
/// alone.
namespace omentum::config_parts {

using ParseInfoTree = google::protobuf::TextFormat::ParseInfoTree;

/// Parses a message, or with `field` the value of one field of it, from protobuf text. A whole
/// number may be written as 1e6. `places` receives where each field stands. Returns the first
/// error, "line:column: reason" (of a value the reason alone) with what an enum allows; empty
/// without one.
std::string parse_text(std::string text, google::protobuf::Message& message,
                       const google::protobuf::FieldDescriptor* field = nullptr,
                       std::unique_ptr<ParseInfoTree>* places = nullptr);

/// Applies one "a.b=c": the value of one knob and nothing beside it. Throws Error naming the path
/// and what is allowed there.
void apply_override(pb::Config& config, const std::string& assignment);

}  // namespace omentum::config_parts
