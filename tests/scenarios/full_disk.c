/* A full disk: below one directory, so many more calls that write succeed, and all further ones fail with ENOSPC.
 *
 * Loaded before the C library (LD_PRELOAD):
 *   FULL_DISK=DIR          the directory
 *   FULL_DISK_ROOM=FILE    two 64-bit numbers, which a test reads and changes while the process runs: the calls that
 *                          still succeed (negative: all), and those that have failed
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/types.h>
#include <unistd.h>

static _Atomic long long *room;

__attribute__((constructor)) static void begin(void) {
    const char *path = getenv("FULL_DISK_ROOM");
    int file = path ? open(path, O_RDWR | O_CLOEXEC) : -1;
    void *seen = file < 0 ? MAP_FAILED : mmap(NULL, 2 * sizeof *room, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    if (seen != MAP_FAILED) room = seen;
    if (file >= 0) close(file);
}

static int below(const char *path) {
    const char *directory = getenv("FULL_DISK");
    return room && directory && *directory && !strncmp(path, directory, strlen(directory));
}

static int on_it(int fd) {
    char link[64], path[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return below(path);
}

/* Whether this call fails; it takes its place. */
static int full(int concerned) {
    if (!concerned) return 0;
    long long left = atomic_load(&room[0]);
    while (left > 0 && !atomic_compare_exchange_weak(&room[0], &left, left - 1)) {}
    if (left) return 0;
    atomic_fetch_add(&room[1], 1);
    errno = ENOSPC;
    return 1;
}

#define REAL(type, name, ...) \
    static type (*real)(__VA_ARGS__); \
    if (!real) real = dlsym(RTLD_NEXT, #name)

ssize_t write(int fd, const void *data, size_t length) {
    REAL(ssize_t, write, int, const void *, size_t);
    return full(on_it(fd)) ? -1 : real(fd, data, length);
}

ssize_t pwrite(int fd, const void *data, size_t length, off_t place) {
    REAL(ssize_t, pwrite, int, const void *, size_t, off_t);
    return full(on_it(fd)) ? -1 : real(fd, data, length, place);
}

ssize_t pwrite64(int fd, const void *data, size_t length, off64_t place) {
    REAL(ssize_t, pwrite64, int, const void *, size_t, off64_t);
    return full(on_it(fd)) ? -1 : real(fd, data, length, place);
}

int fsync(int fd) {
    REAL(int, fsync, int);
    return full(on_it(fd)) ? -1 : real(fd);
}

int fdatasync(int fd) {
    REAL(int, fdatasync, int);
    return full(on_it(fd)) ? -1 : real(fd);
}

int rename(const char *from, const char *to) {
    REAL(int, rename, const char *, const char *);
    return full(below(to)) ? -1 : real(from, to);
}

int link(const char *from, const char *to) {
    REAL(int, link, const char *, const char *);
    return full(below(to)) ? -1 : real(from, to);
}

int linkat(int a, const char *from, int b, const char *to, int flags) {
    REAL(int, linkat, int, const char *, int, const char *, int);
    return full(below(to)) ? -1 : real(a, from, b, to, flags);
}

/* Only a new file needs room. */
#define OPENED(name) \
    int name(const char *path, int flags, ...) { \
        REAL(int, name, const char *, int, ...); \
        va_list words; \
        va_start(words, flags); \
        int mode = flags & O_CREAT ? va_arg(words, int) : 0; \
        va_end(words); \
        return full((flags & O_CREAT) && below(path) && access(path, F_OK)) ? -1 : real(path, flags, mode); \
    }
OPENED(open)
OPENED(open64)
