/* Counts the calls with which a process changes files below a folder, and spoils them from a chosen one on.

   Preloaded before the C library.  A call counts when it concerns a file below the armed folder and one of the armed
   kinds.  The state is shared memory, so that the process that armed it reads the counts after its child is dead.
   Nothing is armed in the processes that the child starts: they do not hold this state. */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

enum { WRITE = 1, TRUNCATE = 2, CREATE = 4, RENAME = 8, UNLINK = 16, SYNC = 32, CHMOD = 64 };
enum { COUNT = 0, KILL = 1, REFUSE_ONE = 2, REFUSE_ALL = 3, FOLDER_RENAMED = 4, FOLDER_REMOVED = 5, FOLDER_EMPTIED = 6, SEND = 7 };

#define SYNCS 4096
#define LOGGED 65536
struct state {
  long calls, at, action, error, kinds, owner, done, syncs;
  char folder[PATH_MAX], name[64];
  double synced[SYNCS]; /* monotonic times at which an fsync of a file returned */
  unsigned char kind[LOGGED];
};
static struct state *shared;

static struct state *state(void) {
  if (!shared) {
    void *made = mmap(NULL, sizeof(struct state), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    shared = made == MAP_FAILED ? NULL : made;
  }
  return shared;
}

/* Called by the process that forks the one to be spoiled. */
void preload_arm(const char *folder, long kinds, long at, long action, long error) {
  struct state *s = state();
  memset(s, 0, sizeof *s);
  strncpy(s->folder, folder, PATH_MAX - 1);
  s->kinds = kinds;
  s->at = at;
  s->action = action;
  s->error = error;
}
/* Called in the forked process: from here on its calls count. */
void preload_begin(void) { state()->owner = getpid(); }
const char *preload_name(void) { return state()->name; }
long preload_kinds(unsigned char *kinds) {
  long n = state()->calls < LOGGED ? state()->calls : LOGGED;
  memcpy(kinds, state()->kind, n);
  return n;
}
long preload_syncs(double *times) {
  long n = state()->syncs < SYNCS ? state()->syncs : SYNCS;
  memcpy(times, state()->synced, n * sizeof(double));
  return n;
}

/* Signals for a whole process, from its loading on: RELIABILITY_SIGNALS="SECONDS NUMBER ..." sends them when it has used
   so much processor time.  That is exact however busy the computer is. */
__attribute__((constructor)) static void send_in_time(void) {
  char *rest = getenv("RELIABILITY_SIGNALS");
  if (!rest) return;
  double after = strtod(rest, &rest);
  struct itimerspec when = {.it_value = {(time_t)after, 1 + (long)(1e9 * (after - (time_t)after))}};
  for (long number = strtol(rest, &rest, 10); number; number = strtol(rest, &rest, 10)) {
    struct sigevent event = {.sigev_notify = SIGEV_SIGNAL, .sigev_signo = (int)number};
    timer_t timer;
    if (timer_create(CLOCK_PROCESS_CPUTIME_ID, &event, &timer) || timer_settime(timer, 0, &when, NULL)) abort();
  }
  unsetenv("RELIABILITY_SIGNALS");
}

static int remove_one(const char *path, const struct stat *st, int type, struct FTW *walk) {
  (void)st, (void)type, (void)walk;
  return remove(path);
}

static void move_folder(long action) {
  char away[PATH_MAX + 8];
  snprintf(away, sizeof away, "%s.away", shared->folder);
  syscall(SYS_rename, shared->folder, away);
  if (action == FOLDER_REMOVED) nftw(away, remove_one, 16, FTW_DEPTH | FTW_PHYS);
  if (action == FOLDER_EMPTIED) syscall(SYS_mkdir, shared->folder, 0755);
}

/* Return 0 to let the call happen, else the errno with which it is refused. */
static int judge(int kind, const char *what, const char *path) {
  struct state *s = shared;
  if (!s || s->owner != getpid() || !(s->kinds & kind) || !s->folder[0]) return 0;
  size_t length = strlen(s->folder);
  if (strncmp(path, s->folder, length) || (path[length] && path[length] != '/')) return 0;
  long n = __sync_add_and_fetch(&s->calls, 1);
  if (n <= LOGGED) s->kind[n - 1] = (unsigned char)kind;
  if (!s->at || n < s->at) return 0;
  if (n == s->at) snprintf(s->name, sizeof s->name, "%s", what);
  switch (s->action) {
    case KILL:
      syscall(SYS_kill, getpid(), SIGKILL);
      for (;;) pause();
    case SEND:
      if (n == s->at) syscall(SYS_kill, getpid(), s->error);
      return 0;
    case REFUSE_ONE: return n == s->at ? (int)s->error : 0;
    case REFUSE_ALL: return (int)s->error;
    case FOLDER_RENAMED: case FOLDER_REMOVED: case FOLDER_EMPTIED:
      if (n == s->at) {
        s->owner = 0;
        move_folder(s->action);
      }
  }
  return 0;
}

static int judge_fd(int kind, const char *what, int fd) {
  char link[64], path[PATH_MAX];
  if (!shared || shared->owner != getpid()) return 0;
  int before = errno;
  snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
  ssize_t n = readlink(link, path, sizeof path - 1);
  errno = before;
  if (n <= 0) return 0;
  path[n] = 0;
  return judge(kind, what, path);
}

static int judge_at(int kind, const char *what, int folder, const char *path) {
  char whole[2 * PATH_MAX], start[PATH_MAX], link[64];
  if (!shared || shared->owner != getpid()) return 0;
  if (path[0] == '/') return judge(kind, what, path);
  int before = errno;
  if (folder == AT_FDCWD) {
    if (!getcwd(start, sizeof start)) start[0] = 0;
  } else {
    snprintf(link, sizeof link, "/proc/self/fd/%d", folder);
    ssize_t n = readlink(link, start, sizeof start - 1);
    start[n > 0 ? n : 0] = 0;
  }
  errno = before;
  snprintf(whole, sizeof whole, "%s/%s", start, path);
  return judge(kind, what, whole);
}

#define NEXT(type, name, ...)                                  \
  static type (*next)(__VA_ARGS__);                            \
  if (!next) next = (type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)
#define REFUSED(expression)        \
  do {                             \
    int code = (expression);       \
    if (code) {                    \
      errno = code;                \
      return -1;                   \
    }                              \
  } while (0)

#define FD_CALL(type, name, kind, parameters, arguments) \
  type name parameters {                                 \
    static type(*next) parameters;                       \
    if (!next) *(void **)&next = dlsym(RTLD_NEXT, #name); \
    REFUSED(judge_fd(kind, #name, fd));                  \
    return next arguments;                               \
  }
#define PATH_CALL(type, name, kind, folder, path, parameters, arguments) \
  type name parameters {                                                 \
    static type(*next) parameters;                                       \
    if (!next) *(void **)&next = dlsym(RTLD_NEXT, #name);                \
    REFUSED(judge_at(kind, #name, folder, path));                        \
    return next arguments;                                               \
  }

FD_CALL(ssize_t, write, WRITE, (int fd, const void *data, size_t n), (fd, data, n))
FD_CALL(ssize_t, pwrite, WRITE, (int fd, const void *data, size_t n, off_t at), (fd, data, n, at))
FD_CALL(ssize_t, pwrite64, WRITE, (int fd, const void *data, size_t n, off64_t at), (fd, data, n, at))
FD_CALL(ssize_t, writev, WRITE, (int fd, const struct iovec *parts, int n), (fd, parts, n))
FD_CALL(ssize_t, sendfile, WRITE, (int fd, int from, off_t *at, size_t n), (fd, from, at, n))
FD_CALL(ssize_t, sendfile64, WRITE, (int fd, int from, off64_t *at, size_t n), (fd, from, at, n))
FD_CALL(ssize_t, copy_file_range, WRITE,
        (int from, off64_t *at, int fd, off64_t *to, size_t n, unsigned flags), (from, at, fd, to, n, flags))
FD_CALL(int, ftruncate, TRUNCATE, (int fd, off_t size), (fd, size))
FD_CALL(int, ftruncate64, TRUNCATE, (int fd, off64_t size), (fd, size))
FD_CALL(int, fchmod, CHMOD, (int fd, mode_t mode), (fd, mode))
PATH_CALL(int, chmod, CHMOD, AT_FDCWD, path, (const char *path, mode_t mode), (path, mode))
PATH_CALL(int, fchmodat, CHMOD, folder, path, (int folder, const char *path, mode_t mode, int flags),
          (folder, path, mode, flags))
PATH_CALL(int, truncate, TRUNCATE, AT_FDCWD, path, (const char *path, off_t size), (path, size))
PATH_CALL(int, truncate64, TRUNCATE, AT_FDCWD, path, (const char *path, off64_t size), (path, size))
PATH_CALL(int, unlink, UNLINK, AT_FDCWD, path, (const char *path), (path))
PATH_CALL(int, unlinkat, UNLINK, folder, path, (int folder, const char *path, int flags), (folder, path, flags))
PATH_CALL(int, rmdir, UNLINK, AT_FDCWD, path, (const char *path), (path))
PATH_CALL(int, mkdir, CREATE, AT_FDCWD, path, (const char *path, mode_t mode), (path, mode))
PATH_CALL(int, rename, RENAME, AT_FDCWD, to, (const char *from, const char *to), (from, to))
PATH_CALL(int, renameat, RENAME, in, to, (int out, const char *from, int in, const char *to), (out, from, in, to))
PATH_CALL(int, renameat2, RENAME, in, to, (int out, const char *from, int in, const char *to, unsigned flags),
          (out, from, in, to, flags))
PATH_CALL(int, link, CREATE, AT_FDCWD, to, (const char *from, const char *to), (from, to))
PATH_CALL(int, linkat, CREATE, in, to, (int out, const char *from, int in, const char *to, int flags),
          (out, from, in, to, flags))

#define SYNC_CALL(name)                                                                             \
  int name(int fd) {                                                                                \
    NEXT(int, #name, int);                                                                          \
    REFUSED(judge_fd(SYNC, #name, fd));                                                             \
    int result = next(fd);                                                                          \
    if (shared && shared->owner == getpid()) {                                                      \
      struct timespec now;                                                                          \
      clock_gettime(CLOCK_MONOTONIC, &now);                                                         \
      long n = __sync_fetch_and_add(&shared->syncs, 1);                                             \
      if (n < SYNCS) shared->synced[n] = (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;           \
    }                                                                                               \
    return result;                                                                                  \
  }
SYNC_CALL(fsync)
SYNC_CALL(fdatasync)

/* A file is created, or an existing one opened for writing. */
#define OPENS(flags) ((flags & (O_CREAT | O_TRUNC)) || (flags & O_ACCMODE) != O_RDONLY)
#define OPEN_CALL(name)                                          \
  int name(const char *path, int flags, ...) {                   \
    NEXT(int, #name, const char *, int, ...);                    \
    va_list rest;                                                \
    va_start(rest, flags);                                       \
    mode_t mode = va_arg(rest, mode_t);                          \
    va_end(rest);                                                \
    if (OPENS(flags)) REFUSED(judge_at(CREATE, #name, AT_FDCWD, path)); \
    return next(path, flags, mode);                              \
  }
#define OPENAT_CALL(name)                                        \
  int name(int folder, const char *path, int flags, ...) {       \
    NEXT(int, #name, int, const char *, int, ...);               \
    va_list rest;                                                \
    va_start(rest, flags);                                       \
    mode_t mode = va_arg(rest, mode_t);                          \
    va_end(rest);                                                \
    if (OPENS(flags)) REFUSED(judge_at(CREATE, #name, folder, path)); \
    return next(folder, path, flags, mode);                      \
  }
OPEN_CALL(open)
OPEN_CALL(open64)
OPENAT_CALL(openat)
OPENAT_CALL(openat64)
