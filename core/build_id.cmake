# Writes the source of build_id() and git_revision(), and leaves it alone when nothing changed. Runs in every build:
#   cmake -DROOT=<source tree> -DFLAGS=<compiler and flags> -DVERSION=<release> -DOUTPUT=<file.cpp> -P core/build_id.cmake
set(text "${FLAGS}\n")
foreach(folder core granting idl learner proto sim_worker)
  file(GLOB_RECURSE files RELATIVE ${ROOT} ${ROOT}/${folder}/*)
  foreach(file ${files})
    if(file MATCHES "\\.(cpp|h|inl|idl|proto|cmake|txt)$")
      file(SHA256 ${ROOT}/${file} hash)
      string(APPEND text "${file} ${hash}\n")
    endif()
  endforeach()
endforeach()
string(SHA256 id "${text}")
string(SUBSTRING ${id} 0 16 id)

set(revision unknown)
execute_process(COMMAND git rev-parse --short=12 HEAD WORKING_DIRECTORY ${ROOT}
  OUTPUT_VARIABLE head OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET RESULT_VARIABLE failed)
if(NOT failed)
  set(revision ${head})
  execute_process(COMMAND git diff --quiet HEAD WORKING_DIRECTORY ${ROOT} ERROR_QUIET RESULT_VARIABLE differs)
  if(differs)
    string(APPEND revision -dirty)
  endif()
endif()

set(source "// Written by core/build_id.cmake.
#include \"core/build_id.h\"

namespace omentum {
std::uint64_t build_id() { return 0x${id}ULL; }
std::string git_revision() { return \"${revision}\"; }
std::string program_version() { return \"omentum ${VERSION}, revision ${revision}, build ${id}\"; }
}  // namespace omentum
")
set(old "")
if(EXISTS ${OUTPUT})
  file(READ ${OUTPUT} old)
endif()
if(NOT old STREQUAL source)
  file(WRITE ${OUTPUT} "${source}")
endif()
