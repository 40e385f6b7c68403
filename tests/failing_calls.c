/* For LD_PRELOAD: lets one call of the system fail, of those that write files in one folder.
 *
 * fail_at(folder, n, error) makes the n-th such call (from 0) fail with that errno; failed() tells
 * whether it has come to that. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static char folder[PATH_MAX];
static long left = -1;
static int error, hit;

void fail_at(const char* path, long n, int number) {
  snprintf(folder, sizeof folder, "%s/", path);
  left = n;
  error = number;
  hit = 0;
}

int failed(void) { return hit; }

static int fails(const char* path) {
  if (left < 0 || strncmp(path, folder, strlen(folder)) != 0) return 0;
  if (left-- > 0) return 0;
  hit = 1;
  errno = error;
  return 1;
}

static int fails_of(int file) {
  char link[64], path[PATH_MAX];
  if (left < 0) return 0;
  snprintf(link, sizeof link, "/proc/self/fd/%d", file);
  const ssize_t n = readlink(link, path, sizeof path - 1);
  if (n < 0) return 0;
  path[n] = 0;
  strncat(path, "/", sizeof path - strlen(path) - 1); /* the folder itself, too */
  return fails(path);
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

#define OPEN(name)                                                                       \
  int name(const char* path, int flags, ...) {                                           \
    va_list more;                                                                        \
    va_start(more, flags);                                                               \
    const int mode = va_arg(more, int);                                                  \
    va_end(more);                                                                        \
    if ((flags & (O_CREAT | O_WRONLY | O_RDWR)) && fails(path)) return -1;               \
    return ((int (*)(const char*, int, ...))dlsym(RTLD_NEXT, #name))(path, flags, mode); \
  }
OPEN(open)
OPEN(open64)

ssize_t write(int file, const void* data, size_t size) {
  return fails_of(file) ? -1 : REAL(write)(file, data, size);
}
int fsync(int file) { return fails_of(file) ? -1 : REAL(fsync)(file); }
int chmod(const char* path, mode_t mode) { return fails(path) ? -1 : REAL(chmod)(path, mode); }
int rename(const char* from, const char* to) { return fails(from) ? -1 : REAL(rename)(from, to); }
int close(int file) {
  if ((fcntl(file, F_GETFL) & O_ACCMODE) == O_RDONLY || !fails_of(file)) return REAL(close)(file);
  REAL(close)(file); /* as Linux does it: gone all the same */
  errno = error;
  return -1;
}
