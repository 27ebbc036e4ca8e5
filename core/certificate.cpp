#include "core/certificate.h"

#include <fcntl.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/pkcs7.h>
#include <openssl/x509.h>
#include <openssl/x509_vfy.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <memory>
#include <optional>

#include "core/clock.h"
#include "core/read_file.h"

namespace omentum {
namespace {

template <auto function>
struct Free {
  template <typename T>
  void operator()(T* object) const {
    function(object);
  }
};
using Bio = std::unique_ptr<BIO, Free<BIO_free_all>>;
using Key = std::unique_ptr<EVP_PKEY, Free<EVP_PKEY_free>>;
using X509File = std::unique_ptr<X509, Free<X509_free>>;
using Crl = std::unique_ptr<X509_CRL, Free<X509_CRL_free>>;
using Store = std::unique_ptr<X509_STORE, Free<X509_STORE_free>>;
using StoreContext = std::unique_ptr<X509_STORE_CTX, Free<X509_STORE_CTX_free>>;
using Signed = std::unique_ptr<PKCS7, Free<PKCS7_free>>;

constexpr const char* kMake = "deploy/security/make.sh";

/// Role of a folder's name, for a line to type.
std::string role_of(const std::string& name) { return name.substr(0, name.find('-')); }

Bio memory_bio(const std::string& text) {
  return Bio(BIO_new_mem_buf(text.data(), static_cast<int>(text.size())));
}

Result<std::string> read_security_file(const std::string& path) {
  // A pipe in its place must not be waited for; read_file() refuses it.
  const int fd = open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  const int error = errno;
  if (fd >= 0) close(fd);
  if (fd < 0 && error == EACCES) {
    return Failure{
        fmt::format("{} cannot be read by user {}, group {}: {} --group {} lets the group read it",
                    path, geteuid(), getegid(), kMake, getegid())};
  }
  if (fd < 0) {
    return Failure{fmt::format("{}: {}: {} --role ROLE makes what is missing", path,
                               std::generic_category().message(error), kMake)};
  }
  Result<std::string> text = read_file(path);
  if (text && text.value().empty())
    return Failure{fmt::format("{} is empty: remove it, and {} makes it anew", path, kMake)};
  return text;
}

/// A PEM file through one of the readers of OpenSSL.
template <typename Owner, typename Read>
Result<Owner> read_pem(const std::string& path, const char* what, Read read) {
  const Result<std::string> text = read_security_file(path);
  if (!text) return Failure{text.error()};
  Owner object(read(memory_bio(text.value()).get(), nullptr, nullptr, nullptr));
  ERR_clear_error();
  if (object == nullptr) {
    return Failure{
        fmt::format("{} holds no {}: copy the folder that {} made again", path, what, kMake)};
  }
  return object;
}

Result<X509File> read_certificate(const std::string& path) {
  return read_pem<X509File>(path, "certificate", PEM_read_bio_X509);
}

std::int64_t seconds_of(const ASN1_TIME* time) {
  std::tm parts{};
  return ASN1_TIME_to_tm(time, &parts) == 1 ? timegm(&parts) : 0;
}

std::string common_name(X509* certificate) {
  std::array<char, 256> text{};
  const int size = X509_NAME_get_text_by_NID(X509_get_subject_name(certificate), NID_commonName,
                                             text.data(), static_cast<int>(text.size()));
  return size > 0 ? std::string(text.data(), static_cast<std::size_t>(size)) : "";
}

/// As in permissions: "CN=worker,O=omentum".
std::string subject_of(X509* certificate) {
  const Bio text(BIO_new(BIO_s_mem()));
  X509_NAME_print_ex(text.get(), X509_get_subject_name(certificate), 0, XN_FLAG_RFC2253);
  char* begin = nullptr;
  const long size = BIO_get_mem_data(text.get(), &begin);
  return {begin, static_cast<std::size_t>(size)};
}

Result<void> check_time(const std::string& what, const std::string& role, std::int64_t begin_s,
                        std::int64_t end_s) {
  const std::int64_t now_s = wall_now_ns() / 1'000'000'000;
  if (now_s < begin_s) {
    return Failure{fmt::format(
        "{} is valid from {}, and the clock of this machine says {}, {} min before it: set the "
        "clock (timedatectl set-ntp true)",
        what, date_text(begin_s), date_text(now_s), (begin_s - now_s + 59) / 60)};
  }
  if (now_s >= end_s) {
    return Failure{fmt::format(
        "{} was valid until {}, and the clock of this machine says {}: {} --renew --role {}, or "
        "set the clock (timedatectl set-ntp true) if that is not the time",
        what, date_text(end_s), date_text(now_s), kMake, role)};
  }
  return {};
}

Result<void> check_time(const std::string& path, const std::string& role, X509* certificate) {
  return check_time(path, role, seconds_of(X509_get0_notBefore(certificate)),
                    seconds_of(X509_get0_notAfter(certificate)));
}

Result<void> check_chain(const std::string& dir, X509* certificate, X509* authority,
                         X509_CRL* revoked) {
  const Store store(X509_STORE_new());
  X509_STORE_add_cert(store.get(), authority);
  X509_STORE_add_crl(store.get(), revoked);
  X509_STORE_set_flags(store.get(), X509_V_FLAG_CRL_CHECK);
  const StoreContext context(X509_STORE_CTX_new());
  X509_STORE_CTX_init(context.get(), store.get(), certificate, nullptr);
  const bool verified = X509_verify_cert(context.get()) == 1;
  const int error = X509_STORE_CTX_get_error(context.get());
  ERR_clear_error();
  if (verified) return {};
  if (error == X509_V_ERR_CERT_REVOKED) {
    const std::string role = role_of(common_name(certificate));
    return Failure{
        fmt::format("{}/certificate.pem is revoked: {} --role {} makes another", dir, kMake, role)};
  }
  return Failure{
      fmt::format("{0}/certificate.pem does not fit {0}/identity_ca.pem and crl.pem ({1}): copy "
                  "the folder that "
                  "{2} made again",
                  dir, X509_verify_cert_error_string(error), kMake)};
}

/// The text that was signed, if it was by this authority.
Result<std::string> signed_text(const std::string& path, X509* authority) {
  const Result<std::string> file = read_security_file(path);
  if (!file) return Failure{file.error()};
  const Store store(X509_STORE_new());
  X509_STORE_add_cert(store.get(), authority);
  BIO* detached = nullptr;
  const Signed message(SMIME_read_PKCS7(memory_bio(file.value()).get(), &detached));
  const Bio content(detached);
  const Bio text(BIO_new(BIO_s_mem()));
  const bool verified = message != nullptr && PKCS7_verify(message.get(), nullptr, store.get(),
                                                           content.get(), text.get(), 0) == 1;
  ERR_clear_error();
  if (!verified) {
    return Failure{fmt::format(
        "{} is not signed by the permissions_ca.pem beside it: copy the folder that {} made again",
        path, kMake)};
  }
  char* begin = nullptr;
  const long size = BIO_get_mem_data(text.get(), &begin);
  return std::string(begin, static_cast<std::size_t>(size));
}

/// What stands between <tag> and </tag>, first time.
std::string element(const std::string& xml, const std::string& tag) {
  const std::size_t open_at = xml.find("<" + tag + ">");
  if (open_at == std::string::npos) return "";
  const std::size_t begin = open_at + tag.size() + 2;
  const std::size_t end = xml.find("</" + tag + ">", begin);
  return end == std::string::npos ? "" : xml.substr(begin, end - begin);
}

std::optional<std::int64_t> xml_seconds(const std::string& text) {
  std::tm parts{};
  const char* end = strptime(text.c_str(), "%Y-%m-%dT%H:%M:%SZ", &parts);
  if (end == nullptr || *end != '\0') return std::nullopt;
  return timegm(&parts);
}

struct Validity {
  std::int64_t begin_s = 0;
  std::int64_t end_s = 0;
};

Result<Validity> validity_of(const std::string& path, const std::string& xml) {
  const std::optional<std::int64_t> begin = xml_seconds(element(xml, "not_before"));
  const std::optional<std::int64_t> end = xml_seconds(element(xml, "not_after"));
  if (!begin || !end)
    return Failure{fmt::format("{}: no permissions of {}: no validity in UTC", path, kMake)};
  return Validity{*begin, *end};
}

struct SecurityFiles {
  X509File identity_ca, permissions_ca, certificate;
  Key key;
  Crl revoked;
};

Result<SecurityFiles> read_files(const std::string& dir) {
  SecurityFiles files;
  const std::array<std::pair<const char*, X509File*>, 3> certificates{
      {{"/identity_ca.pem", &files.identity_ca},
       {"/permissions_ca.pem", &files.permissions_ca},
       {"/certificate.pem", &files.certificate}}};
  for (const auto& [name, into] : certificates) {
    Result<X509File> read = read_certificate(dir + name);
    if (!read) return Failure{read.error()};
    *into = std::move(read).value();
  }
  // Without a password: an empty one is asked of nobody.
  char none[] = "";
  Result<Key> key = read_pem<Key>(dir + "/key.pem", "key without a password",
                                  [&none](BIO* bio, EVP_PKEY** at, pem_password_cb*, void*) {
                                    return PEM_read_bio_PrivateKey(bio, at, nullptr, none);
                                  });
  if (!key) return Failure{key.error()};
  files.key = std::move(key).value();
  Result<Crl> revoked =
      read_pem<Crl>(dir + "/crl.pem", "list of revoked certificates", PEM_read_bio_X509_CRL);
  if (!revoked) return Failure{revoked.error()};
  files.revoked = std::move(revoked).value();
  return files;
}

Result<Validity> check_permissions(const std::string& dir, const SecurityFiles& files) {
  const std::string path = dir + "/permissions.p7s";
  const Result<std::string> text = signed_text(path, files.permissions_ca.get());
  if (!text) return Failure{text.error()};
  const std::string subject = subject_of(files.certificate.get());
  const std::string named = element(text.value(), "subject_name");
  if (named != subject) {
    return Failure{
        fmt::format("{} is for \"{}\", and certificate.pem for \"{}\": copy the folder that {} "
                    "made again",
                    path, named, subject, kMake)};
  }
  Result<Validity> validity = validity_of(path, text.value());
  if (!validity) return Failure{validity.error()};
  const std::string role = role_of(common_name(files.certificate.get()));
  if (Result<void> timely =
          check_time(path, role, validity.value().begin_s, validity.value().end_s);
      !timely)
    return Failure{timely.error()};
  return validity;
}

}  // namespace

std::string date_text(std::int64_t time_s) {
  const auto time = static_cast<std::time_t>(time_s);
  std::tm parts{};
  gmtime_r(&time, &parts);
  std::array<char, 64> text{};
  std::strftime(text.data(), text.size(), "%Y-%m-%d %H:%M:%S UTC", &parts);
  return text.data();
}

std::string certificate_name(const std::string& path) {
  const Result<X509File> certificate = read_certificate(path);
  return certificate ? common_name(certificate.value().get()) : "";
}

Result<Certificate> check_security_dir(const std::string& dir) {
  const Result<SecurityFiles> read = read_files(dir);
  if (!read) return Failure{read.error()};
  const SecurityFiles& files = read.value();
  X509* const certificate = files.certificate.get();
  const std::string name = common_name(certificate);
  const std::string role = role_of(name);

  const bool fits = X509_check_private_key(certificate, files.key.get()) == 1;
  ERR_clear_error();
  if (!fits) {
    return Failure{fmt::format(
        "{0}/key.pem is not the key of {0}/certificate.pem: copy the folder that {1} made again",
        dir, kMake)};
  }
  // Before the chain, which knows of times only that they are wrong.
  for (const auto& [file, of] : {std::pair{"/certificate.pem", certificate},
                                 std::pair{"/identity_ca.pem", files.identity_ca.get()},
                                 std::pair{"/permissions_ca.pem", files.permissions_ca.get()}}) {
    if (Result<void> timely = check_time(dir + file, role, of); !timely)
      return Failure{timely.error()};
  }
  if (Result<void> chain =
          check_chain(dir, certificate, files.identity_ca.get(), files.revoked.get());
      !chain)
    return Failure{chain.error()};
  const Result<std::string> governance =
      signed_text(dir + "/governance.p7s", files.permissions_ca.get());
  if (!governance) return Failure{governance.error()};
  if (governance.value().find("<domain_access_rules>") == std::string::npos)
    return Failure{
        fmt::format("{}/governance.p7s holds no governance: copy the folder again", dir)};
  const Result<Validity> permissions = check_permissions(dir, files);
  if (!permissions) return Failure{permissions.error()};

  Certificate result;
  result.name = name;
  result.begin_s =
      std::max(seconds_of(X509_get0_notBefore(certificate)), permissions.value().begin_s);
  result.end_s = std::min(seconds_of(X509_get0_notAfter(certificate)), permissions.value().end_s);
  return result;
}

Result<std::int64_t> certificate_end(const std::string& dir) {
  const Result<X509File> certificate = read_certificate(dir + "/certificate.pem");
  if (!certificate) return Failure{certificate.error()};
  const Result<X509File> authority = read_certificate(dir + "/permissions_ca.pem");
  if (!authority) return Failure{authority.error()};
  const std::string path = dir + "/permissions.p7s";
  const Result<std::string> text = signed_text(path, authority.value().get());
  if (!text) return Failure{text.error()};
  const Result<Validity> validity = validity_of(path, text.value());
  if (!validity) return Failure{validity.error()};
  return std::min(seconds_of(X509_get0_notAfter(certificate.value().get())),
                  validity.value().end_s);
}

}  // namespace omentum
