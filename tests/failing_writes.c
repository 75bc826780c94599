/* Preloaded into a process, lets what changes files below a folder fail, from the n-th call on, as on a full disk.
 *
 * FAULTS_UNDER is the folder. FAULTS_CONTROL is a file of four 32-bit integers, mapped and shared with the test:
 * errno (0: nothing fails), number of the first call that fails (1: the next), calls since then, calls that failed.
 * Calls that free space (unlink, ftruncate to less) fail only for errors other than a full disk.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

struct control { volatile int error, first, calls, failed; };

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

static struct control *control(void) {
    static struct control *mapped;
    if (!mapped) {
        static int (*real_open)(const char *, int, ...);
        if (!real_open) real_open = (int (*)(const char *, int, ...))dlsym(RTLD_NEXT, "open");
        const char *path = getenv("FAULTS_CONTROL");
        int file = path ? real_open(path, O_RDWR | O_CLOEXEC) : -1;
        if (file < 0) return NULL;
        void *at = mmap(NULL, sizeof *mapped, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
        close(file);
        if (at == MAP_FAILED) return NULL;
        mapped = at;
    }
    return mapped;
}

static int below(const char *path) {
    const char *under = getenv("FAULTS_UNDER");
    return under && strncmp(path, under, strlen(under)) == 0;
}

static int fails(int frees) {
    struct control *c = control();
    if (!c || !c->error) return 0;
    if (frees && (c->error == ENOSPC || c->error == EDQUOT)) return 0;
    if (__sync_add_and_fetch(&c->calls, 1) < c->first) return 0;
    __sync_add_and_fetch(&c->failed, 1);
    errno = c->error;
    return 1;
}

static int file_fails(int file, int frees) {
    char link[64], path[PATH_MAX];
    struct control *c = control();
    if (!c || !c->error) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length <= 0) return 0;
    path[length] = 0;
    return below(path) && fails(frees);
}

static int path_fails(const char *path, int frees) { return below(path) && fails(frees); }

ssize_t write(int f, const void *b, size_t n) { return file_fails(f, 0) ? -1 : REAL(write)(f, b, n); }
ssize_t pwrite(int f, const void *b, size_t n, off_t o) { return file_fails(f, 0) ? -1 : REAL(pwrite)(f, b, n, o); }
ssize_t pwrite64(int f, const void *b, size_t n, off64_t o) { return file_fails(f, 0) ? -1 : REAL(pwrite64)(f, b, n, o); }
int fsync(int f) { return file_fails(f, 0) ? -1 : REAL(fsync)(f); }
int fdatasync(int f) { return file_fails(f, 0) ? -1 : REAL(fdatasync)(f); }
int ftruncate(int f, off_t n) { return file_fails(f, 1) ? -1 : REAL(ftruncate)(f, n); }
int ftruncate64(int f, off64_t n) { return file_fails(f, 1) ? -1 : REAL(ftruncate64)(f, n); }
int posix_fallocate(int f, off_t o, off_t n) { return file_fails(f, 0) ? errno : REAL(posix_fallocate)(f, o, n); }
int posix_fallocate64(int f, off64_t o, off64_t n) { return file_fails(f, 0) ? errno : REAL(posix_fallocate64)(f, o, n); }
int mkdir(const char *p, mode_t m) { return path_fails(p, 0) ? -1 : REAL(mkdir)(p, m); }
int unlink(const char *p) { return path_fails(p, 1) ? -1 : REAL(unlink)(p); }
int rename(const char *a, const char *b) { return path_fails(b, 0) ? -1 : REAL(rename)(a, b); }

static int makes(const char *path, int flags) {
    struct stat found;
    return (flags & O_CREAT) && below(path) && stat(path, &found) != 0;
}

#define OPENING(name)                                                                   \
    int name(const char *path, int flags, ...) {                                        \
        mode_t mode = 0;                                                                \
        if (flags & (O_CREAT | O_TMPFILE)) {                                            \
            va_list rest;                                                               \
            va_start(rest, flags);                                                      \
            mode = va_arg(rest, mode_t);                                                \
            va_end(rest);                                                               \
        }                                                                               \
        if (makes(path, flags) && fails(0)) return -1;                                  \
        return ((int (*)(const char *, int, ...))dlsym(RTLD_NEXT, #name))(path, flags, mode); \
    }

OPENING(open)
OPENING(open64)
