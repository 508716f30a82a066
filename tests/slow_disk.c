/* A slow disk: what is written below one directory takes its time, as on a worn card or a share over the net.
 *
 * Loaded before the C library (LD_PRELOAD), so that the program under test is as it always is:
 *   SLOW_DISK=DIR          the directory
 *   SLOW_DISK_WRITE_MS=N   how long each write takes
 *   SLOW_DISK_SYNC_MS=N    how long each fsync and each rename takes
 * As long as DIR.hang exists, the disk answers nothing at all.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <unistd.h>

static int below(const char *path) {
    const char *directory = getenv("SLOW_DISK");
    return directory && *directory && !strncmp(path, directory, strlen(directory));
}

static int on_it(int fd) {
    char link[64], path[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return below(path);
}

static void wait_for_it(const char *name) {
    const char *took = getenv(name);
    char hang[4096];
    usleep(1000 * (took ? atoi(took) : 0));
    snprintf(hang, sizeof hang, "%s.hang", getenv("SLOW_DISK"));
    while (!access(hang, F_OK)) usleep(20000);
}

ssize_t write(int fd, const void *data, size_t length) {
    static ssize_t (*real)(int, const void *, size_t);
    if (!real) real = dlsym(RTLD_NEXT, "write");
    if (on_it(fd)) wait_for_it("SLOW_DISK_WRITE_MS");
    return real(fd, data, length);
}

int fsync(int fd) {
    static int (*real)(int);
    if (!real) real = dlsym(RTLD_NEXT, "fsync");
    if (on_it(fd)) wait_for_it("SLOW_DISK_SYNC_MS");
    return real(fd);
}

int rename(const char *from, const char *to) {
    static int (*real)(const char *, const char *);
    if (!real) real = dlsym(RTLD_NEXT, "rename");
    if (below(to)) wait_for_it("SLOW_DISK_SYNC_MS");
    return real(from, to);
}
