#pragma once

#include <cstdint>
#include <string>

#include "core/result.h"

namespace omentum {

/// What the folder of --security-dir makes of a program (docs/cluster.md 5). Times in seconds since
/// 1970 UTC.
struct Certificate {
  std::string name;  ///< role, or role-host, as deploy/security/make.sh named the folder
  std::int64_t begin_s = 0;
  std::int64_t end_s = 0;  ///< of certificate and permissions, whichever is first
};

/// Reads and verifies everything that Cyclone will read from the folder: files, key, chain, list of
/// revoked certificates, signatures, and that this moment is within every validity. Fails with one
/// line that says what is wrong and what to type; Cyclone would fail with a number, or go on.
Result<Certificate> check_security_dir(const std::string& dir);

/// End of the certificate and permissions that lie there now, valid or not [s since 1970 UTC]:
/// later than when the program joined where they have been renewed since.
Result<std::int64_t> certificate_end(const std::string& dir);

/// Common name of a certificate file: the name above. Empty where there is none.
std::string certificate_name(const std::string& path);

/// "2026-11-23 05:00:00 UTC"
std::string date_text(std::int64_t time_s);

}  // namespace omentum
