// Preloaded (LD_PRELOAD) it makes one write fail as on a full disk: the OMENTUM_FAIL_WRITE-th, counted from 1, of those to
// files below OMENTUM_FAIL_UNDER. 0: none fails; their number is written to OMENTUM_FAIL_COUNT at the end.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/uio.h>
#include <unistd.h>

static atomic_long writes;

static int fails(int fd) {
  const char* under = getenv("OMENTUM_FAIL_UNDER");
  const char* wanted = getenv("OMENTUM_FAIL_WRITE");
  if (under == NULL || wanted == NULL) return 0;
  char link[64], path[4096];
  snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
  const ssize_t size = readlink(link, path, sizeof path - 1);
  if (size <= 0) return 0;
  path[size] = '\0';
  if (strncmp(path, under, strlen(under)) != 0) return 0;
  if (atomic_fetch_add(&writes, 1) + 1 != atol(wanted)) return 0;
  errno = ENOSPC;
  return 1;
}

ssize_t write(int fd, const void* bytes, size_t size) {
  static ssize_t (*real)(int, const void*, size_t);
  if (real == NULL) *(void**)&real = dlsym(RTLD_NEXT, "write");
  return fails(fd) ? -1 : real(fd, bytes, size);
}

ssize_t writev(int fd, const struct iovec* parts, int count) {
  static ssize_t (*real)(int, const struct iovec*, int);
  if (real == NULL) *(void**)&real = dlsym(RTLD_NEXT, "writev");
  return fails(fd) ? -1 : real(fd, parts, count);
}

__attribute__((destructor)) static void tell(void) {
  const char* path = getenv("OMENTUM_FAIL_COUNT");
  if (path == NULL || atomic_load(&writes) == 0) return;
  FILE* file = fopen(path, "w");
  if (file == NULL) return;
  fprintf(file, "%ld\n", atomic_load(&writes));
  fclose(file);
}
