/* What programs call: functions of the system that tell the time, wait, or start and end what waits. */
#include "lockstep.h"

enum { CHILDREN = 256 };

static const int64_t POLLED_NS = 2 * 1000000; /* at most, from one look at a descriptor without data to the next; guess */
static __thread int empty = -1;               /* the descriptor that this thread has found to be without data */

static int64_t receive_limit[DESCRIPTORS]; /* SO_RCVTIMEO [ns] */
static pid_t children[CHILDREN];           /* processes that this one has started, and not waited for yet */

/* ---- time ---- */

int clock_gettime(clockid_t clock, struct timespec *t)
{
    int64_t base = S && !outside ? base_of(clock) : -1;
    if (base < 0)
        return REAL(clock_gettime)(clock, t);
    look();
    *t = timespec_of(base + now());
    return 0;
}

int gettimeofday(struct timeval *t, void *zone)
{
    (void)zone;
    struct timespec found;
    clock_gettime(CLOCK_REALTIME, &found);
    *t = (struct timeval){found.tv_sec, found.tv_nsec / 1000};
    return 0;
}

time_t time(time_t *t)
{
    struct timespec found;
    clock_gettime(CLOCK_REALTIME, &found);
    if (t)
        *t = found.tv_sec;
    return found.tv_sec;
}

int timespec_get(struct timespec *t, int base)
{
    return base == TIME_UTC && !clock_gettime(CLOCK_REALTIME, t) ? base : 0;
}

int clock_nanosleep(clockid_t clock, int flags, const struct timespec *wanted, struct timespec *left)
{
    if (!self() || base_of(clock) < 0)
        return REAL(clock_nanosleep)(clock, flags, wanted, left);
    if (wanted->tv_sec < 0 || wanted->tv_nsec < 0 || wanted->tv_nsec >= SECOND)
        return EINVAL;
    int64_t until = flags & TIMER_ABSTIME ? absolute(clock, wanted) : after(ns_of(wanted));
    if (until <= now())
        look();
    else if (empty >= 0 && until < after(POLLED_NS)) { /* it will look again: once there is something */
        struct pollfd polled = {.fd = empty, .events = POLLIN};
        ready(&polled, 1, after(POLLED_NS));
    }
    empty = -1;
    if (sleep_until(until))
        return 0;
    if (left && !(flags & TIMER_ABSTIME))
        *left = timespec_of(until > now() ? until - now() : 0);
    return EINTR;
}

int nanosleep(const struct timespec *wanted, struct timespec *left)
{
    errno = clock_nanosleep(CLOCK_MONOTONIC, 0, wanted, left);
    return errno ? -1 : 0;
}

int usleep(useconds_t microseconds)
{
    struct timespec wanted = timespec_of(microseconds * 1000LL);
    return nanosleep(&wanted, NULL);
}

unsigned sleep(unsigned seconds)
{
    struct timespec wanted = {seconds, 0}, left = {0};
    return nanosleep(&wanted, &left) ? left.tv_sec + (left.tv_nsec > 0) : 0;
}

int sched_yield(void)
{
    if (S && !outside)
        look();
    return REAL(sched_yield)();
}

/* ---- descriptors ---- */

int ioctl(int fd, unsigned long request, ...)
{
    va_list arguments;
    va_start(arguments, request);
    void *argument = va_arg(arguments, void *);
    va_end(arguments);
    int result = REAL(ioctl)(fd, request, argument);
    if (request == FIONREAD)
        empty = S && !outside && !result && !*(int *)argument ? fd : -1;
    return result;
}

int poll(struct pollfd *fds, nfds_t n, int timeout_ms)
{
    if (!self())
        return REAL(poll)(fds, n, timeout_ms);
    int found = REAL(poll)(fds, n, 0);
    if (found || !timeout_ms) {
        if (!found)
            look();
        return found;
    }
    found = ready(fds, n, after(timeout_ms * MILLISECOND));
    return found < 0 ? -1 : REAL(poll)(fds, n, 0);
}

int __poll_chk(struct pollfd *fds, nfds_t n, int timeout_ms, size_t size)
{
    (void)size;
    return poll(fds, n, timeout_ms);
}

int ppoll(struct pollfd *fds, nfds_t n, const struct timespec *timeout, const sigset_t *mask)
{
    if (!self())
        return REAL(ppoll)(fds, n, timeout, mask);
    sigset_t before;
    if (mask)
        pthread_sigmask(SIG_SETMASK, mask, &before);
    int found = REAL(poll)(fds, n, 0);
    if (!found && (!timeout || ns_of(timeout) > 0)) {
        found = ready(fds, n, timeout ? after(ns_of(timeout)) : NEVER);
        found = found < 0 ? -1 : REAL(poll)(fds, n, 0);
    }
    int error = errno;
    if (mask)
        pthread_sigmask(SIG_SETMASK, &before, NULL);
    errno = error;
    return found;
}

int __ppoll_chk(struct pollfd *fds, nfds_t n, const struct timespec *timeout, const sigset_t *mask, size_t size)
{
    (void)size;
    return ppoll(fds, n, timeout, mask);
}

static int wait_for_sets(int n, fd_set *r, fd_set *w, fd_set *e, int64_t until)
{
    struct pollfd fds[FD_SETSIZE];
    nfds_t count = 0;
    for (int fd = 0; fd < n && fd < FD_SETSIZE; fd++) {
        short events = (r && FD_ISSET(fd, r) ? POLLIN : 0) | (w && FD_ISSET(fd, w) ? POLLOUT : 0) |
                       (e && FD_ISSET(fd, e) ? POLLPRI : 0);
        if (events)
            fds[count++] = (struct pollfd){.fd = fd, .events = events};
    }
    return ready(fds, count, until);
}

int select(int n, fd_set *r, fd_set *w, fd_set *e, struct timeval *timeout)
{
    if (!self())
        return REAL(select)(n, r, w, e, timeout);
    int64_t limit = timeout ? timeout->tv_sec * SECOND + timeout->tv_usec * 1000LL : -1;
    if (!limit)
        look();
    else if (wait_for_sets(n, r, w, e, after(limit)) < 0)
        return -1;
    return REAL(select)(n, r, w, e, &(struct timeval){0});
}

int pselect(int n, fd_set *r, fd_set *w, fd_set *e, const struct timespec *timeout, const sigset_t *mask)
{
    sigset_t before;
    if (mask)
        pthread_sigmask(SIG_SETMASK, mask, &before);
    struct timeval limit = timeout ? (struct timeval){timeout->tv_sec, timeout->tv_nsec / 1000} : (struct timeval){0};
    int found = select(n, r, w, e, timeout ? &limit : NULL), error = errno;
    if (mask)
        pthread_sigmask(SIG_SETMASK, &before, NULL);
    errno = error;
    return found;
}

static int wait_for_events(int epoll, struct epoll_event *events, int most, int64_t timeout_ns)
{
    int found = REAL(epoll_wait)(epoll, events, most, 0);
    if (found || !timeout_ns) {
        if (!found)
            look();
        return found;
    }
    struct pollfd fd = {.fd = epoll, .events = POLLIN};
    for (int64_t until = after(timeout_ns);;) {
        int any = ready(&fd, 1, until);
        if (any < 0)
            return -1;
        found = REAL(epoll_wait)(epoll, events, most, 0);
        if (found || !any)
            return found;
    }
}

int epoll_wait(int epoll, struct epoll_event *events, int most, int timeout_ms)
{
    return self() ? wait_for_events(epoll, events, most, timeout_ms * MILLISECOND)
                  : REAL(epoll_wait)(epoll, events, most, timeout_ms);
}

int epoll_pwait(int epoll, struct epoll_event *events, int most, int timeout_ms, const sigset_t *mask)
{
    sigset_t before;
    if (mask)
        pthread_sigmask(SIG_SETMASK, mask, &before);
    int found = epoll_wait(epoll, events, most, timeout_ms), error = errno;
    if (mask)
        pthread_sigmask(SIG_SETMASK, &before, NULL);
    errno = error;
    return found;
}

int epoll_pwait2(int epoll, struct epoll_event *events, int most, const struct timespec *timeout, const sigset_t *mask)
{
    sigset_t before;
    if (mask)
        pthread_sigmask(SIG_SETMASK, mask, &before);
    int64_t limit = timeout ? ns_of(timeout) : -1;
    int found = self() ? wait_for_events(epoll, events, most, limit)
                       : REAL(epoll_wait)(epoll, events, most, limit < 0 ? -1 : limit / MILLISECOND);
    int error = errno;
    if (mask)
        pthread_sigmask(SIG_SETMASK, &before, NULL);
    errno = error;
    return found;
}

/* Wait until a read does not block; false with errno if it has failed already. */
static bool readable(int fd, int flags)
{
    if (!self() || flags & MSG_DONTWAIT)
        return true;
    struct pollfd wanted = {.fd = fd, .events = POLLIN};
    if (REAL(poll)(&wanted, 1, 0))
        return true;
    int mode = fcntl(fd, F_GETFL);
    if (mode < 0 || mode & O_NONBLOCK)
        return true;
    int64_t limit = fd < DESCRIPTORS && receive_limit[fd] ? receive_limit[fd] : -1;
    int found = ready(&wanted, 1, after(limit));
    if (!found)
        errno = EAGAIN;
    return found > 0;
}

/* What may make the descriptors of others ready. */
static void touch(void)
{
    if (S)
        S->touched = true;
}

/* And fills the buffer of a connection, if others never get the time to read from it. */
static void send_more(void)
{
    if (S && !outside)
        look();
    touch();
}

#define AFTER(before, type, name, parameters, ...) \
    type name parameters                           \
    {                                              \
        before();                                  \
        return REAL(name)(__VA_ARGS__);            \
    }

AFTER(touch, ssize_t, write, (int fd, const void *data, size_t size), fd, data, size)
AFTER(touch, ssize_t, writev, (int fd, const struct iovec *parts, int n), fd, parts, n)
AFTER(send_more, ssize_t, send, (int fd, const void *data, size_t size, int flags), fd, data, size, flags)
AFTER(send_more, ssize_t, sendmsg, (int fd, const struct msghdr *message, int flags), fd, message, flags)
AFTER(send_more, ssize_t, sendto,
      (int fd, const void *data, size_t size, int flags, const struct sockaddr *to, socklen_t length), fd, data, size,
      flags, to, length)
AFTER(touch, int, connect, (int fd, const struct sockaddr *address, socklen_t length), fd, address, length)
AFTER(touch, int, shutdown, (int fd, int how), fd, how)

ssize_t read(int fd, void *data, size_t size) { return readable(fd, 0) ? REAL(read)(fd, data, size) : -1; }

ssize_t __read_chk(int fd, void *data, size_t size, size_t room)
{
    if (size > room)
        abort();
    return read(fd, data, size);
}

ssize_t readv(int fd, const struct iovec *parts, int n) { return readable(fd, 0) ? REAL(readv)(fd, parts, n) : -1; }

ssize_t recv(int fd, void *data, size_t size, int flags)
{
    return readable(fd, flags) ? REAL(recv)(fd, data, size, flags) : -1;
}

ssize_t __recv_chk(int fd, void *data, size_t size, size_t room, int flags)
{
    if (size > room)
        abort();
    return recv(fd, data, size, flags);
}

ssize_t recvfrom(int fd, void *data, size_t size, int flags, struct sockaddr *from, socklen_t *length)
{
    return readable(fd, flags) ? REAL(recvfrom)(fd, data, size, flags, from, length) : -1;
}

ssize_t __recvfrom_chk(int fd, void *data, size_t size, size_t room, int flags, struct sockaddr *from, socklen_t *length)
{
    if (size > room)
        abort();
    return recvfrom(fd, data, size, flags, from, length);
}

ssize_t recvmsg(int fd, struct msghdr *message, int flags)
{
    return readable(fd, flags) ? REAL(recvmsg)(fd, message, flags) : -1;
}

int accept(int fd, struct sockaddr *address, socklen_t *length)
{
    return readable(fd, 0) ? REAL(accept)(fd, address, length) : -1;
}

int accept4(int fd, struct sockaddr *address, socklen_t *length, int flags)
{
    return readable(fd, 0) ? REAL(accept4)(fd, address, length, flags) : -1;
}

int socket(int domain, int type, int protocol)
{
    int fd = REAL(socket)(domain, type, protocol);
    if (S && fd >= 0 && (type & 0xf) == SOCK_STREAM && (domain == AF_INET || domain == AF_INET6))
        /* bytes that wait in the kernel for real time would be late in ours */
        REAL(setsockopt)(fd, IPPROTO_TCP, TCP_NODELAY, &(int){1}, sizeof(int));
    return fd;
}

int setsockopt(int fd, int level, int name, const void *value, socklen_t size)
{
    if (S && level == SOL_SOCKET && name == SO_RCVTIMEO && size >= sizeof(struct timeval) && fd >= 0 &&
        fd < DESCRIPTORS) {
        const struct timeval *t = value;
        receive_limit[fd] = t->tv_sec * SECOND + t->tv_usec * 1000LL;
    }
    return REAL(setsockopt)(fd, level, name, value, size);
}

int close(int fd)
{
    if (S)
        S->touched = true;
    if (S && fd >= 0 && fd < DESCRIPTORS) {
        receive_limit[fd] = 0;
        if (timers[fd].used && !outside) {
            lock();
            timers[fd].used = false;
            unlock();
        }
    }
    return REAL(close)(fd);
}

/* ---- timer descriptors: event descriptors that the agent writes to ---- */

int timerfd_create(int clock, int flags)
{
    if (!self() || base_of(clock) < 0)
        return REAL(timerfd_create)(clock, flags);
    int fd = eventfd(0, flags);
    if (fd >= DESCRIPTORS) {
        REAL(close)(fd);
        errno = EMFILE;
        return -1;
    }
    if (fd >= 0) {
        lock();
        timers[fd] = (struct timer){.used = true, .clock = clock, .until = NEVER};
        unlock();
    }
    return fd;
}

static struct itimerspec left_of(const struct timer *t)
{
    int64_t left = t->until == NEVER ? 0 : t->until > S->now ? t->until - S->now : 1;
    return (struct itimerspec){timespec_of(t->interval), timespec_of(left)};
}

int timerfd_settime(int fd, int flags, const struct itimerspec *wanted, struct itimerspec *before)
{
    if (!self() || fd < 0 || fd >= DESCRIPTORS || !timers[fd].used)
        return REAL(timerfd_settime)(fd, flags, wanted, before);
    struct timer *t = &timers[fd];
    struct pollfd expired = {.fd = fd, .events = POLLIN};
    eventfd_t times;
    lock();
    if (before)
        *before = left_of(t);
    if (REAL(poll)(&expired, 1, 0) > 0)
        REAL(read)(fd, &times, sizeof times);
    int64_t value = ns_of(&wanted->it_value);
    t->interval = ns_of(&wanted->it_interval);
    t->until = !value ? NEVER : flags & TFD_TIMER_ABSTIME ? value - base_of(t->clock) : after(value);
    expire_timers();
    unlock();
    return 0;
}

int timerfd_gettime(int fd, struct itimerspec *found)
{
    if (!self() || fd < 0 || fd >= DESCRIPTORS || !timers[fd].used)
        return REAL(timerfd_gettime)(fd, found);
    *found = left_of(&timers[fd]);
    return 0;
}

/* ---- locks ---- */

/* Try until it succeeds, as who holds it may release it later; ETIMEDOUT at the time limit. */
#define ACQUIRE(attempt, address, limit)                                \
    do {                                                                \
        struct waiter w = {.key = address};                             \
        int64_t until = limit;                                          \
        lock();                                                         \
        keyed++;                                                        \
        while ((result = attempt) == EBUSY) {                           \
            if (now() >= until) {                                       \
                result = ETIMEDOUT;                                     \
                break;                                                  \
            }                                                           \
            await(&w, until);                                           \
        }                                                               \
        keyed--;                                                        \
        unlock();                                                       \
    } while (0)

int pthread_mutex_lock(pthread_mutex_t *mutex)
{
    if (!S || outside)
        return REAL(pthread_mutex_lock)(mutex);
    int result = REAL(pthread_mutex_trylock)(mutex);
    if (result == EBUSY && self())
        ACQUIRE(REAL(pthread_mutex_trylock)(mutex), mutex, NEVER);
    return result;
}

int pthread_mutex_clocklock(pthread_mutex_t *mutex, clockid_t clock, const struct timespec *limit)
{
    if (!S || outside)
        return REAL(pthread_mutex_clocklock)(mutex, clock, limit);
    int result = REAL(pthread_mutex_trylock)(mutex);
    if (result == EBUSY && self())
        ACQUIRE(REAL(pthread_mutex_trylock)(mutex), mutex, absolute(clock, limit));
    return result;
}

int pthread_mutex_timedlock(pthread_mutex_t *mutex, const struct timespec *limit)
{
    return S && !outside ? pthread_mutex_clocklock(mutex, CLOCK_REALTIME, limit)
                         : REAL(pthread_mutex_timedlock)(mutex, limit);
}

int pthread_mutex_unlock(pthread_mutex_t *mutex)
{
    int result = REAL(pthread_mutex_unlock)(mutex);
    notify(mutex, 1);
    return result;
}

int pthread_rwlock_rdlock(pthread_rwlock_t *rw)
{
    if (!self())
        return REAL(pthread_rwlock_rdlock)(rw);
    int result = pthread_rwlock_tryrdlock(rw);
    if (result == EBUSY)
        ACQUIRE(pthread_rwlock_tryrdlock(rw), rw, NEVER);
    return result;
}

int pthread_rwlock_wrlock(pthread_rwlock_t *rw)
{
    if (!self())
        return REAL(pthread_rwlock_wrlock)(rw);
    int result = pthread_rwlock_trywrlock(rw);
    if (result == EBUSY)
        ACQUIRE(pthread_rwlock_trywrlock(rw), rw, NEVER);
    return result;
}

int pthread_rwlock_unlock(pthread_rwlock_t *rw)
{
    int result = REAL(pthread_rwlock_unlock)(rw);
    notify(rw, INT_MAX);
    return result;
}

static int try_semaphore(sem_t *semaphore) { return sem_trywait(semaphore) ? EBUSY : 0; }

static int take_semaphore(sem_t *semaphore, int64_t until)
{
    int result;
    struct waiter w = {.key = semaphore, .shared = true};
    lock();
    keyed++;
    while ((result = try_semaphore(semaphore))) {
        if (now() >= until)
            result = ETIMEDOUT;
        else if (!await(&w, until))
            result = EINTR;
        else
            continue;
        break;
    }
    keyed--;
    unlock();
    errno = result;
    return result ? -1 : 0;
}

int sem_clockwait(sem_t *semaphore, clockid_t clock, const struct timespec *limit)
{
    return self() ? take_semaphore(semaphore, absolute(clock, limit)) : REAL(sem_clockwait)(semaphore, clock, limit);
}

int sem_timedwait(sem_t *semaphore, const struct timespec *limit)
{
    return self() ? take_semaphore(semaphore, absolute(CLOCK_REALTIME, limit))
                  : REAL(sem_timedwait)(semaphore, limit);
}

int sem_wait(sem_t *semaphore) { return self() ? take_semaphore(semaphore, NEVER) : REAL(sem_wait)(semaphore); }

int sem_post(sem_t *semaphore)
{
    int result = REAL(sem_post)(semaphore);
    notify(semaphore, 1);
    return result;
}

/* ---- condition variables: their memory holds only the clock ---- */

int pthread_cond_init(pthread_cond_t *condition, const pthread_condattr_t *attributes)
{
    clockid_t clock = CLOCK_REALTIME;
    if (attributes)
        pthread_condattr_getclock(attributes, &clock);
    memset(condition, 0, sizeof *condition);
    memcpy(condition, &clock, sizeof clock);
    return 0;
}

int pthread_cond_destroy(pthread_cond_t *condition)
{
    (void)condition;
    return 0;
}

static int wait_for_condition(pthread_cond_t *condition, pthread_mutex_t *mutex, int64_t until)
{
    lock();
    struct waiter w = {.key = condition, .switching = until - now() == GIL_NS};
    bool late = now() >= until;
    int result = REAL(pthread_mutex_unlock)(mutex);
    if (!result) {
        wake_key(mutex, 1);
        if (!late)
            await(&w, until);
        late = w.early || now() >= until;
    }
    unlock();
    if (!result)
        pthread_mutex_lock(mutex);
    return result ? result : late ? ETIMEDOUT : 0;
}

int pthread_cond_clockwait(pthread_cond_t *condition, pthread_mutex_t *mutex, clockid_t clock,
                           const struct timespec *limit)
{
    return self() ? wait_for_condition(condition, mutex, absolute(clock, limit))
                  : REAL(pthread_cond_clockwait)(condition, mutex, clock, limit);
}

int pthread_cond_timedwait(pthread_cond_t *condition, pthread_mutex_t *mutex, const struct timespec *limit)
{
    clockid_t clock;
    memcpy(&clock, condition, sizeof clock);
    return self() ? wait_for_condition(condition, mutex, absolute(clock, limit))
                  : REAL(pthread_cond_timedwait)(condition, mutex, limit);
}

int pthread_cond_wait(pthread_cond_t *condition, pthread_mutex_t *mutex)
{
    return self() ? wait_for_condition(condition, mutex, NEVER) : REAL(pthread_cond_wait)(condition, mutex);
}

int pthread_cond_signal(pthread_cond_t *condition)
{
    if (!S)
        return REAL(pthread_cond_signal)(condition);
    notify(condition, 1);
    return 0;
}

int pthread_cond_broadcast(pthread_cond_t *condition)
{
    if (!S)
        return REAL(pthread_cond_broadcast)(condition);
    notify(condition, INT_MAX);
    return 0;
}

long syscall(long number, ...)
{
    va_list list;
    va_start(list, number);
    long a = va_arg(list, long), b = va_arg(list, long), c = va_arg(list, long), d = va_arg(list, long),
         e = va_arg(list, long), f = va_arg(list, long);
    va_end(list);
    int operation = b & FUTEX_CMD_MASK;
    if (number != SYS_futex || !self())
        return REAL(syscall)(number, a, b, c, d, e, f);
    const void *word = (const void *)a;
    if (operation == FUTEX_WAKE || operation == FUTEX_WAKE_BITSET) {
        int woken = notify(word, c);
        return woken ? woken : REAL(syscall)(number, a, b, c, d, e, f);
    }
    if (operation != FUTEX_WAIT && operation != FUTEX_WAIT_BITSET)
        return REAL(syscall)(number, a, b, c, d, e, f);
    const struct timespec *limit = (const struct timespec *)d;
    clockid_t clock = b & FUTEX_CLOCK_REALTIME ? CLOCK_REALTIME : CLOCK_MONOTONIC;
    int64_t until = !limit ? NEVER : operation == FUTEX_WAIT ? after(ns_of(limit)) : absolute(clock, limit);
    struct waiter w = {.key = word};
    errno = 0;
    lock();
    if (*(const volatile uint32_t *)word != (uint32_t)c)
        errno = EAGAIN;
    else if (now() >= until || (await(&w, until) && now() >= until))
        errno = ETIMEDOUT;
    unlock();
    return errno ? -1 : 0;
}

/* ---- threads and processes ---- */

struct start {
    void *(*function)(void *);
    void *argument;
    struct slot *slot;
};

static void *started(void *argument)
{
    struct start start = *(struct start *)argument;
    free(argument);
    register_thread(start.slot);
    return start.function(start.argument);
}

int pthread_create(pthread_t *thread, const pthread_attr_t *attributes, void *(*function)(void *), void *argument)
{
    if (!self())
        return REAL(pthread_create)(thread, attributes, function, argument);
    struct start *start = malloc(sizeof *start);
    lock();
    *start = (struct start){function, argument, new_slot(P->pid, RUNNING)};
    start->slot->tid = -1;
    unlock();
    struct slot *slot = start->slot;
    int result = REAL(pthread_create)(thread, attributes, started, start);
    lock();
    if (result)
        free_slot(slot);
    else if (slot->tid < 0) /* it has not begun yet */
        slot->thread = *thread;
    unlock();
    if (result)
        free(start);
    return result;
}

int pthread_join(pthread_t thread, void **result)
{
    if (self()) {
        struct waiter w = {.key = (const void *)thread};
        lock();
        for (struct slot *s = S->slots; s < S->slots + S->used; s++)
            if (s->state != FREE && s->pid == P->pid && s->thread == thread && s != mine) {
                await(&w, NEVER);
                break;
            }
        unlock();
    }
    return REAL(pthread_join)(thread, result);
}

static void add_child(pid_t child)
{
    for (int i = 0; i < CHILDREN; i++)
        if (!children[i]) {
            children[i] = child;
            return;
        }
}

pid_t fork(void)
{
    if (!self())
        return REAL(fork)();
    lock();
    struct slot *slot = new_slot(P->pid, RUNNING);
    slot->tid = -1;
    unlock();
    pid_t child = REAL(fork)();
    if (child > 0) {
        lock();
        add_child(child);
        if (slot->state != FREE && slot->pid == P->pid)
            slot->pid = child;
        unlock();
    } else if (child < 0) {
        lock();
        free_slot(slot);
        unlock();
    } else {
        slot->pid = getpid();
        waiters = NULL;
        keyed = 0;
        memset(children, 0, sizeof children);
        P = NULL;
        memset(timers, 0, sizeof timers);
        register_thread(slot);
        join_clock();
    }
    return child;
}

pid_t vfork(void) { return fork(); }

static void expect(pid_t child)
{
    if (!self())
        return;
    lock();
    add_child(child);
    bool there = false;
    for (struct slot *s = S->slots; s < S->slots + S->used; s++)
        there |= s->state != FREE && s->pid == child;
    if (!there)
        new_slot(child, EXPECTED);
    unlock();
}

int posix_spawn(pid_t *child, const char *path, const posix_spawn_file_actions_t *actions,
                const posix_spawnattr_t *attributes, char *const arguments[], char *const environment[])
{
    pid_t own;
    int result = REAL(posix_spawn)(child ? child : &own, path, actions, attributes, arguments, environment);
    if (!result)
        expect(child ? *child : own);
    return result;
}

int posix_spawnp(pid_t *child, const char *file, const posix_spawn_file_actions_t *actions,
                 const posix_spawnattr_t *attributes, char *const arguments[], char *const environment[])
{
    pid_t own;
    int result = REAL(posix_spawnp)(child ? child : &own, file, actions, attributes, arguments, environment);
    if (!result)
        expect(child ? *child : own);
    return result;
}

/* Wait for a process as for a descriptor; 0 or less: for any child. False with errno after a signal. */
static bool wait_for_child(pid_t child)
{
    if (!self())
        return true;
    struct pollfd fds[CHILDREN];
    nfds_t n = 0;
    for (int i = 0; i < CHILDREN; i++)
        if (children[i] && (child <= 0 || children[i] == child)) {
            int fd = REAL(syscall)(SYS_pidfd_open, children[i], 0);
            if (fd >= 0)
                fds[n++] = (struct pollfd){.fd = fd, .events = POLLIN};
        }
    int found = n ? ready(fds, n, NEVER) : 1, error = errno;
    while (n)
        REAL(close)(fds[--n].fd);
    errno = error;
    return found > 0;
}

static pid_t reaped(pid_t child)
{
    for (int i = 0; i < CHILDREN; i++)
        if (child > 0 && children[i] == child)
            children[i] = 0;
    if (child > 0 && self())
        forget_if_gone(child);
    return child;
}

pid_t waitpid(pid_t child, int *status, int options)
{
    return options & WNOHANG || wait_for_child(child) ? reaped(REAL(waitpid)(child, status, options)) : -1;
}

pid_t wait4(pid_t child, int *status, int options, struct rusage *usage)
{
    return options & WNOHANG || wait_for_child(child) ? reaped(REAL(wait4)(child, status, options, usage)) : -1;
}

int waitid(idtype_t type, id_t id, siginfo_t *information, int options)
{
    if (!(options & WNOHANG) && !wait_for_child(type == P_PID ? id : 0))
        return -1;
    return REAL(waitid)(type, id, information, options);
}

int kill(pid_t to, int number)
{
    int result = REAL(kill)(to, number);
    if (!result && number && number != SIGSTOP && self())
        tell_signalled(to);
    return result;
}

int killpg(pid_t group, int number) { return group < 0 ? REAL(killpg)(group, number) : kill(-group, number); }

#define SIGNALLED(type, name, parameters, ...) \
    type name parameters                       \
    {                                          \
        bool clocked = self();                 \
        if (clocked)                           \
            begin_call();                      \
        type result = REAL(name)(__VA_ARGS__); \
        if (clocked)                           \
            end_call();                        \
        return result;                         \
    }

SIGNALLED(int, sigsuspend, (const sigset_t *set), set)
SIGNALLED(int, sigwait, (const sigset_t *set, int *found), set, found)
SIGNALLED(int, sigwaitinfo, (const sigset_t *set, siginfo_t *found), set, found)

int pause(void)
{
    sigset_t mask;
    pthread_sigmask(SIG_BLOCK, NULL, &mask);
    return sigsuspend(&mask);
}

pid_t wait(int *status) { return waitpid(-1, status, 0); }

pid_t wait3(int *status, int options, struct rusage *usage) { return wait4(-1, status, options, usage); }

void _exit(int status)
{
    leave();
    REAL(_exit)(status);
    __builtin_unreachable();
}
