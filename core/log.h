#pragma once

#include <spdlog/logger.h>

#include <memory>
#include <string_view>

namespace omentum {

/// The process logger: stderr, one event per line, key=value. Include this header from .cpp files
/// only: it pulls spdlog in (2.8 s per translation unit). Never used inside step(). Warnings and
/// errors that begin alike are told five times a minute, the others counted.
spdlog::logger& log();

/// Names the program in every line; call once at the start of main().
void name_log(std::string_view program);

}  // namespace omentum
