/* What the clock (clock.c) and the functions that programs call instead of the system's (calls.c) know of each other. */
#pragma once
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <linux/futex.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <pthread.h>
#include <semaphore.h>
#include <signal.h>
#include <spawn.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <sys/timerfd.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#pragma GCC visibility push(hidden)

enum { SLOTS = 1024, PROCESSES = 128, DESCRIPTORS = 4096, BELLS_FROM = 512 };
enum state { FREE, EXPECTED, RUNNING, WAITING, STRAY };

static const int64_t NEVER = INT64_MAX, SECOND = 1000000000, MILLISECOND = 1000000;
static const int64_t GIL_NS = 5000000; /* CPython's switch interval: see `watch` */

/* The function that ours replaces. All are looked up when the library is loaded: dlsym waits for the dynamic loader,
   which must not happen with our lock, since a library that is just being loaded may wait for that. */
struct real {
    const char *name;
    void *function;
};

void *look_up(struct real *real);

#define REAL(name)                                                                                      \
    ({                                                                                                  \
        static struct real real __attribute__((section("real"), aligned(sizeof(struct real)), used)) = { \
            #name, NULL};                                                                               \
        (__typeof__(&name))(real.function ? real.function : look_up(&real));                            \
    })

struct slot {
    int32_t pid, tid;
    uint32_t state, wakes; /* wakes: a futex */
    bool locking;          /* it waits for our lock */
    uint32_t waits;        /* how often it has waited */
    int32_t bell;          /* event descriptor of its process that ends a wait for descriptors */
    int64_t until;         /* WAITING: shared clock; EXPECTED: real time since when */
    uint64_t thread;
};

struct process {
    int32_t pid;
    uint32_t calls; /* futex of its agent */
    uint32_t told, watching;
    int64_t timer; /* when the next timer descriptor expires */
};

struct shared {
    /* the first three are written by who starts the processes (emulator/lockstep/clock.py) */
    double speed;         /* times real time at most */
    uint32_t released;    /* until then, the clock stops at HOLD_NS, so that whatever is started first is at rest */
    uint32_t joined;      /* processes that have ever had this clock */
    _Atomic int64_t now;
    double paced_at;
    int64_t paced_real, paced_now; /* since when this speed applies */
    int64_t resume;                /* real time until which the speed does not permit to advance */
    uint32_t born;                 /* 1 while the rest is initialized, then 2 */
    uint32_t running, busy, strays; /* threads that run, agents that have been told something, strays */
    uint32_t used;                 /* slots that have ever been used */
    uint64_t activity;             /* counts what happens */
    _Atomic bool touched;          /* a descriptor may have become ready since all were checked */
    int64_t real_base, monotonic_base;
    pthread_mutex_t lock;
    struct process processes[PROCESSES];
    struct slot slots[SLOTS];
};

struct waiter {
    struct slot *slot;
    const void *key;    /* what it waits for besides descriptors: woken by `wake_key` */
    struct pollfd *fds; /* n, and room for its bell */
    nfds_t n;
    bool switching, early; /* of CPython's global lock */
    bool shared; /* another process may fulfil it without our notice: it is tried again from time to time */
    struct waiter *next;
};

struct timer {
    bool used;
    clockid_t clock;
    int64_t until, interval;
};

extern struct shared *S;         /* NULL: this process has real time */
extern struct process *P;        /* this one */
extern struct waiter *waiters;   /* of this process, in the order in which they came */
extern _Atomic int keyed;        /* how many of them have a key, or are about to get one */
extern struct timer timers[DESCRIPTORS];
extern __thread struct slot *mine;
extern __thread bool outside; /* this thread is ours, or has ended for us */

int64_t real_now(void);
void lock(void);
void unlock(void);

/* The shared clock, and times on it: NEVER for a negative duration, and without a limit. */
int64_t now(void);
int64_t after(int64_t ns);
int64_t absolute(clockid_t clock, const struct timespec *t);
int64_t base_of(clockid_t clock); /* its value when the shared clock is 0; negative for processor time, which is real */

static inline int64_t ns_of(const struct timespec *t) { return t->tv_sec * SECOND + t->tv_nsec; }

static inline struct timespec timespec_of(int64_t ns) { return (struct timespec){ns / SECOND, ns % SECOND}; }

/* The slot of this thread; NULL for one that has real time. */
struct slot *self(void);

/* Wait with the lock, which others have meanwhile. Returns false if a signal ended it. */
bool await(struct waiter *w, int64_t until);

/* Wake up to `most` waiters for this key, in the order in which they came; returns how many. `notify` takes the lock. */
int wake_key(const void *key, int most);
int notify(const void *key, int most);

/* Wait until one of the descriptors is ready: the number of ready ones, 0 at the time limit, -1 after a signal. */
int ready(const struct pollfd *wanted, nfds_t n, int64_t until);

/* Around a call that waits, which only the kernel ends. */
void begin_call(void);
void end_call(void);

/* Sleep: whether no signal ended it. */
bool sleep_until(int64_t until);

/* Count looks at the clock: whoever does nothing else must see it advance. */
void look(void);

void expire_timers(void);

/* Threads and processes that begin and end. */
struct slot *new_slot(int32_t pid, enum state state);
void free_slot(struct slot *slot);
void register_thread(struct slot *slot);
void join_clock(void);
void forget_if_gone(int pid);
void leave(void);

/* Of a signal, to a process, or to a group as for kill(2): it has something to do, if only to end. */
void tell_signalled(int to);

#pragma GCC visibility pop
