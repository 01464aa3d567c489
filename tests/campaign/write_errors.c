/* Fails the N-th call on a folder that writes: preloaded into a run, which it counts for or disturbs. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

static char folder[PATH_MAX];
static int failing_errno, is_sticky;
static atomic_long failing, calls, failures;

/* `nth` 0: count only. `sticky`: all writes from the N-th on fail, as on a full disk. */
void write_errors_arm(const char *path, long nth, int number, int sticky) {
    strncpy(folder, path, sizeof folder - 1);
    failing_errno = number;
    is_sticky = sticky;
    atomic_store(&calls, 0);
    atomic_store(&failures, 0);
    atomic_store(&failing, nth);
}
long write_errors_calls(void) { return atomic_load(&calls); }
long write_errors_failures(void) { return atomic_load(&failures); }

static int in_folder(const char *path) {
    char found[PATH_MAX];
    if (!folder[0] || !path) return 0;
    if (path[0] != '/') {
        if (!getcwd(found, sizeof found)) return 0;
        strncat(found, "/", sizeof found - strlen(found) - 1);
        strncat(found, path, sizeof found - strlen(found) - 1);
        path = found;
    }
    size_t size = strlen(folder);
    return strncmp(path, folder, size) == 0 && (path[size] == '/' || !path[size]);
}
static int fd_in_folder(int fd) {
    char link[64], found[PATH_MAX];
    if (!folder[0]) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t size = readlink(link, found, sizeof found - 1);
    if (size <= 0) return 0;
    found[size] = 0;
    return in_folder(found);
}
static int fails(int is_write) {
    long number = atomic_fetch_add(&calls, 1) + 1, nth = atomic_load(&failing);
    if (nth && (number == nth || (is_sticky && is_write && number > nth))) {
        atomic_fetch_add(&failures, 1);
        errno = failing_errno;
        return 1;
    }
    return 0;
}
#define REAL(type, name, ...) static type (*real)(__VA_ARGS__); if (!real) real = dlsym(RTLD_NEXT, name)

ssize_t write(int fd, const void *data, size_t size) {
    REAL(ssize_t, "write", int, const void *, size_t);
    return fd_in_folder(fd) && fails(1) ? -1 : real(fd, data, size);
}
ssize_t pwrite(int fd, const void *data, size_t size, off_t at) {
    REAL(ssize_t, "pwrite", int, const void *, size_t, off_t);
    return fd_in_folder(fd) && fails(1) ? -1 : real(fd, data, size, at);
}
ssize_t pwrite64(int fd, const void *data, size_t size, off64_t at) {
    REAL(ssize_t, "pwrite64", int, const void *, size_t, off64_t);
    return fd_in_folder(fd) && fails(1) ? -1 : real(fd, data, size, at);
}
ssize_t writev(int fd, const struct iovec *parts, int count) {
    REAL(ssize_t, "writev", int, const struct iovec *, int);
    return fd_in_folder(fd) && fails(1) ? -1 : real(fd, parts, count);
}
int fsync(int fd) {
    REAL(int, "fsync", int);
    return fd_in_folder(fd) && fails(1) ? -1 : real(fd);
}
int fdatasync(int fd) {
    REAL(int, "fdatasync", int);
    return fd_in_folder(fd) && fails(1) ? -1 : real(fd);
}
int ftruncate64(int fd, off64_t size) {
    REAL(int, "ftruncate64", int, off64_t);
    return fd_in_folder(fd) && fails(1) ? -1 : real(fd, size);
}
int close(int fd) {
    REAL(int, "close", int);
    int is_written = fd > 2 && fd_in_folder(fd) && (fcntl(fd, F_GETFL) & O_ACCMODE) != O_RDONLY;
    if (is_written && fails(1)) {
        real(fd); /* as NFS: closed, and the data are lost */
        errno = failing_errno;
        return -1;
    }
    return real(fd);
}
int rename(const char *from, const char *to) {
    REAL(int, "rename", const char *, const char *);
    return in_folder(to) && fails(0) ? -1 : real(from, to);
}
int renameat(int a, const char *from, int b, const char *to) {
    REAL(int, "renameat", int, const char *, int, const char *);
    return in_folder(to) && fails(0) ? -1 : real(a, from, b, to);
}
int linkat(int a, const char *from, int b, const char *to, int flags) {
    REAL(int, "linkat", int, const char *, int, const char *, int);
    return in_folder(to) && fails(0) ? -1 : real(a, from, b, to, flags);
}
int link(const char *from, const char *to) {
    REAL(int, "link", const char *, const char *);
    return in_folder(to) && fails(0) ? -1 : real(from, to);
}
int mkdir(const char *path, mode_t mode) {
    REAL(int, "mkdir", const char *, mode_t);
    return in_folder(path) && fails(1) ? -1 : real(path, mode);
}
int chmod(const char *path, mode_t mode) {
    REAL(int, "chmod", const char *, mode_t);
    return in_folder(path) && fails(0) ? -1 : real(path, mode);
}
#define OPENS(name)                                                              \
    int name(const char *path, int flags, ...) {                                 \
        REAL(int, #name, const char *, int, ...);                                \
        mode_t mode = 0;                                                         \
        if (flags & (O_CREAT | O_TMPFILE)) {                                     \
            va_list more;                                                        \
            va_start(more, flags);                                               \
            mode = va_arg(more, mode_t);                                         \
            va_end(more);                                                        \
        }                                                                        \
        if ((flags & O_ACCMODE) != O_RDONLY && in_folder(path) && fails(1)) return -1; \
        return real(path, flags, mode);                                          \
    }
OPENS(open)
OPENS(open64)
