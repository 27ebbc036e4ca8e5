#pragma once

#include <string>

#include "tests/integration/programs.h"

namespace omentum::test {

/// Folders of roles that deploy/security/make.sh made for one test.
class Certificates {
 public:
  explicit Certificates(Programs& programs) : programs_(programs) {
    make({"--role", "learner", "--role", "worker", "--role", "mismatch", "--role", "tool"});
  }
  /// What make.sh printed.
  std::string make(const Strings& arguments) {
    const Finished made =
        programs_.finish(Strings{OMENTUM_MAKE_SECURITY, "--out", root()} + arguments);
    EXPECT_EQ(made.code, 0) << made.err;
    return made.out;
  }
  std::string root() const { return programs_.folder() / "security"; }
  std::string of(const std::string& role) const { return root() + "/" + role; }
  Strings option(const std::string& role) const { return {"--security-dir", of(role)}; }

 private:
  Programs& programs_;
};

}  // namespace omentum::test
