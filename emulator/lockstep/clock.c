/* One clock for several processes, which advances only while all their threads wait.
 *
 * Preloaded (LD_PRELOAD) into each of them, with a file of zeros in UR_LOCKSTEP that they share. Whatever asks for the
 * time gets the shared clock; whatever waits for a time, a file descriptor, a lock or another thread is counted as
 * waiting. When nobody runs, each process checks the descriptors that its threads wait for; if none is ready, the clock
 * jumps to the earliest time that somebody waits for.
 *
 * Words: a slot is a thread of any process. A waiter is a thread of this process that waits. An agent is our thread in
 * each process, which does what other processes ask for. A stray is a thread that waits in a way unknown to us.
 *
 * Everything shared, and every list of waiters, is protected by one lock, which no one keeps while waiting.
 */
#include "lockstep.h"

static const int64_t WATCH_NS = 10 * 1000000;   /* real time between two looks of an agent at its process */
static const int64_t HOLD_NS = 2000000000;      /* shared clock: enough for an emulator to be ready */
static const int64_t BUSY_NS = 1000000000;      /* processor time without waiting, after which the clock goes on */
static const int LONGEST = 64; /* times that the clock advances before others have the lock */
static const int64_t EXPECTED_NS = 1000000000;  /* real time in which a new process has to appear */
static const int64_t SPIN_NS = 100 * 1000;      /* what a thread waits that only looks at the clock */
static const int SPINS = 100, SPINS_MORE = 10;  /* looks at the clock before the first such wait, and the next */

struct shared *S;
struct process *P;
struct waiter *waiters;
_Atomic int keyed;
struct timer timers[DESCRIPTORS];
__thread struct slot *mine;
__thread bool outside;
static __thread int looks;
static bool left; /* this process has left the clock: it ends */
static pthread_key_t ending;

static long futex(uint32_t *word, int operation, uint32_t value, const struct timespec *limit)
{
    return REAL(syscall)(SYS_futex, word, operation, value, limit, NULL, 0);
}

static int64_t real_time(clockid_t clock)
{
    struct timespec t;
    REAL(clock_gettime)(clock, &t);
    return ns_of(&t);
}

int64_t real_now(void) { return real_time(CLOCK_MONOTONIC); }

/* ---- the shared clock ---- */

void unlock(void) { REAL(pthread_mutex_unlock)(&S->lock); }

void lock(void)
{
    if (mine)
        mine->locking = true;
    if (REAL(pthread_mutex_lock)(&S->lock) == EOWNERDEAD)
        pthread_mutex_consistent(&S->lock);
    if (mine)
        mine->locking = false;
    if (left && !outside) /* the process ends, and with it this thread */
        for (unlock();;)
            REAL(poll)(NULL, 0, -1);
}

int64_t base_of(clockid_t clock)
{
    switch (clock) {
    case CLOCK_REALTIME:
    case CLOCK_REALTIME_COARSE:
    case CLOCK_TAI:
        return S->real_base;
    case CLOCK_MONOTONIC:
    case CLOCK_MONOTONIC_RAW:
    case CLOCK_MONOTONIC_COARSE:
    case CLOCK_BOOTTIME:
        return S->monotonic_base;
    default:
        return -1; /* processor time, which is real */
    }
}

int64_t now(void) { return atomic_load(&S->now); }

int64_t after(int64_t ns) { return ns < 0 ? NEVER : ns > NEVER - now() ? NEVER : now() + ns; }

int64_t absolute(clockid_t clock, const struct timespec *t) { return t ? ns_of(t) - base_of(clock) : NEVER; }

static void run(struct slot *slot)
{
    S->strays -= slot->state == STRAY;
    slot->state = RUNNING;
    S->running++;
    S->activity++;
}

static void tell(struct process *process)
{
    if (!process->told) {
        process->told = 1;
        S->busy++;
    }
    process->calls++;
    futex(&process->calls, FUTEX_WAKE, 1, NULL);
}

static void ring(struct slot *slot)
{
    slot->wakes++;
    if (slot->bell < 0)
        futex(&slot->wakes, FUTEX_WAKE, 1, NULL);
    else if (slot->pid == P->pid)
        eventfd_write(slot->bell, 1);
    else
        for (struct process *p = S->processes; p < S->processes + PROCESSES; p++)
            if (p->pid == slot->pid)
                tell(p);
}

void expire_timers(void)
{
    P->timer = NEVER;
    for (int fd = 0; fd < DESCRIPTORS; fd++) {
        struct timer *t = &timers[fd];
        if (!t->used)
            continue;
        if (t->until <= S->now) {
            int64_t times = t->interval ? 1 + (S->now - t->until) / t->interval : 1;
            t->until = t->interval ? t->until + times * t->interval : NEVER;
            eventfd_write(fd, times);
        }
        if (t->until < P->timer)
            P->timer = t->until;
    }
}

/* Let those waiters of this process run whose descriptors are ready; the kernel is waking them already. */
static void check_descriptors(void)
{
    static struct pollfd all[DESCRIPTORS]; /* protected by the lock */
    nfds_t n = 0;
    for (struct waiter *w = waiters; w; w = w->next)
        if (w->slot->state == WAITING && n + w->n <= DESCRIPTORS) {
            memcpy(all + n, w->fds, w->n * sizeof *all);
            n += w->n;
        }
    if (!n || REAL(poll)(all, n, 0) <= 0)
        return;
    n = 0;
    for (struct waiter *w = waiters; w; w = w->next)
        if (w->slot->state == WAITING && n + w->n <= DESCRIPTORS) {
            bool ready = false;
            for (nfds_t i = 0; i < w->n; i++)
                ready |= all[n++].revents != 0;
            if (ready)
                run(w->slot);
        }
}

static void set_clock(int64_t time)
{
    if (time > S->now)
        atomic_store(&S->now, time);
    for (struct slot *s = S->slots; s < S->slots + S->used; s++)
        if (s->state == WAITING && s->until <= S->now) {
            run(s);
            ring(s);
        }
    for (struct process *p = S->processes; p < S->processes + PROCESSES; p++)
        if (p->pid && p->timer <= S->now) {
            if (p == P) {
                expire_timers();
                check_descriptors();
            } else {
                tell(p);
            }
        }
}

/* Whether the limit of the speed permits this time. */
static bool due(int64_t time)
{
    double speed = S->strays && S->speed > 1.0 ? 1.0 : S->speed; /* nobody knows when a stray goes on */
    if (!S->released || speed > 1e9) {
        S->paced_at = speed;
        return S->released || time <= HOLD_NS;
    }
    int64_t real = real_now();
    if (speed != S->paced_at) {
        S->paced_at = speed;
        S->paced_real = real;
        S->paced_now = S->now;
    }
    S->resume = S->paced_real + (int64_t)((time - S->paced_now) / speed);
    return S->resume <= real;
}

static int64_t next_time(void)
{
    int64_t next = NEVER;
    for (struct slot *s = S->slots; s < S->slots + S->used; s++)
        if (s->state == WAITING && s->until < next)
            next = s->until;
    for (struct process *p = S->processes; p < S->processes + PROCESSES; p++)
        if (p->pid && p->timer < next)
            next = p->timer;
    return next;
}

/* Advance the clock if nobody runs. */
static void settle(void)
{
    for (int times = 0; !S->running && !S->busy; times++) {
        if (times == LONGEST) { /* let others have the lock */
            tell(P);
            return;
        }
        if (S->touched) {
            S->touched = false;
            for (struct process *p = S->processes; p < S->processes + PROCESSES; p++)
                if (p->pid && p->watching) {
                    if (p == P)
                        check_descriptors();
                    else
                        tell(p);
                }
            continue;
        }
        int64_t next = next_time();
        if (next == NEVER || !due(next))
            return;
        set_clock(next);
    }
}

/* ---- waiting ---- */

void register_thread(struct slot *slot)
{
    slot->tid = REAL(syscall)(SYS_gettid);
    slot->thread = pthread_self();
    mine = slot;
    pthread_setspecific(ending, slot);
}

struct slot *new_slot(int32_t pid, enum state state)
{
    for (struct slot *s = S->slots; s < S->slots + SLOTS; s++)
        if (s->state == FREE) {
            *s = (struct slot){.pid = pid, .bell = -1, .until = state == EXPECTED ? real_now() : 0};
            run(s);
            s->state = state;
            if (s - S->slots >= S->used)
                S->used = s - S->slots + 1;
            return s;
        }
    fprintf(stderr, "lockstep: more than %d threads\n", SLOTS);
    abort();
}

void free_slot(struct slot *slot)
{
    if (slot->state == RUNNING || slot->state == EXPECTED)
        S->running--;
    S->strays -= slot->state == STRAY;
    slot->state = FREE;
    S->activity++;
    S->touched = true; /* what it had open is closed */
}

struct slot *self(void)
{
    if (!S || outside)
        return NULL;
    if (!mine) {
        lock();
        register_thread(new_slot(P->pid, RUNNING));
        unlock();
    } else if (mine->state == STRAY) {
        lock();
        if (mine->state == STRAY)
            run(mine);
        unlock();
    }
    return mine;
}

static int own_bell(void)
{
    int low = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    int high = fcntl(low, F_DUPFD_CLOEXEC, BELLS_FROM);
    if (high < 0)
        return low;
    REAL(close)(low);
    return high;
}

static void quieten(int bell)
{
    eventfd_t rung;
    eventfd_read(bell, &rung);
}

bool await(struct waiter *w, int64_t until)
{
    struct slot *slot = w->slot = mine;
    bool signalled = false;
    struct waiter **end = &waiters;
    while (*end)
        end = &(*end)->next;
    *end = w;
    w->next = NULL;
    looks = 0;
    slot->waits++;
    if (w->key)
        keyed++;
    if (w->n) {
        if (mine->bell < 0)
            mine->bell = own_bell();
        w->fds[w->n] = (struct pollfd){.fd = mine->bell, .events = POLLIN};
        P->watching++;
    }
    int bell = slot->bell;
    if (!w->n)
        slot->bell = -1;
    slot->until = until;
    slot->state = WAITING;
    S->running--;
    settle();
    while (slot->state == WAITING) {
        uint32_t wakes = slot->wakes;
        unlock();
        errno = 0;
        int ready = w->n ? REAL(ppoll)(w->fds, w->n + 1, NULL, NULL) : futex(&slot->wakes, FUTEX_WAIT, wakes, NULL);
        int error = errno;
        lock();
        if (slot->state != WAITING)
            break;
        signalled = ready < 0 && error == EINTR;
        bool real = false;
        for (nfds_t i = 0; w->n && ready > 0 && i < w->n; i++)
            real |= w->fds[i].revents != 0;
        if (signalled || real)
            run(slot);
        else if (w->n && ready > 0 && w->fds[w->n].revents & POLLNVAL) /* a program that closes all descriptors */
            w->fds[w->n].fd = slot->bell = bell = own_bell();
        else if (w->n)
            quieten(bell);
    }
    slot->bell = bell;
    if (w->n) {
        quieten(bell);
        P->watching--;
    }
    if (w->key)
        keyed--;
    for (end = &waiters; *end != w;)
        end = &(*end)->next;
    *end = w->next;
    return !signalled;
}

int wake_key(const void *key, int most)
{
    int woken = 0;
    for (struct waiter *w = waiters; w && woken < most; w = w->next)
        if (w->key == key && w->slot->state == WAITING) {
            run(w->slot);
            ring(w->slot);
            woken++;
        }
    return woken;
}

int notify(const void *key, int most)
{
    if (!S || !keyed)
        return 0;
    lock();
    int woken = wake_key(key, most);
    unlock();
    return woken;
}

int ready(const struct pollfd *wanted, nfds_t n, int64_t until)
{
    struct pollfd fds[n + 1];
    memcpy(fds, wanted, n * sizeof *fds);
    struct waiter w = {.fds = fds, .n = n};
    for (;;) {
        int count = REAL(poll)(fds, n, 0);
        if (count)
            return count;
        lock();
        bool late = now() >= until, undisturbed = true;
        if (!late)
            undisturbed = await(&w, until);
        unlock();
        if (late)
            return 0;
        if (!undisturbed) {
            errno = EINTR;
            return -1;
        }
    }
}

void begin_call(void)
{
    lock();
    mine->waits++;
    mine->until = NEVER;
    mine->state = WAITING;
    S->running--;
    settle();
    unlock();
}

void end_call(void)
{
    int error = errno;
    lock();
    if (mine->state == WAITING)
        run(mine);
    unlock();
    errno = error;
}

bool sleep_until(int64_t until)
{
    struct waiter w = {0};
    lock();
    bool undisturbed = now() >= until || await(&w, until);
    unlock();
    return undisturbed;
}

void look(void)
{
    if (++looks > SPINS && self()) {
        sleep_until(after(SPIN_NS));
        looks = SPINS - SPINS_MORE;
    }
}

/* ---- the agent ---- */

/* clock_gettime(2): the processor time of a thread of this process. */
static clockid_t processor_clock(int tid) { return (clockid_t)(~(unsigned)tid << 3 | 6); }

static char state_of(int tid, long *switches)
{
    char path[64], text[2048];
    snprintf(path, sizeof path, "/proc/self/task/%d/status", tid);
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0)
        return 0;
    ssize_t size = REAL(read)(fd, text, sizeof text - 1);
    REAL(close)(fd);
    text[size < 0 ? 0 : size] = 0;
    const char *state = strstr(text, "State:\t"), *count = strstr(text, "\nvoluntary_ctxt_switches:\t");
    *switches = count ? atol(count + 26) : 0;
    return state ? state[7] : 0;
}

/* Whether all its threads have ended: the last one frees the memory, long after the first. */
static bool gone(int pid)
{
    struct pollfd process = {.fd = REAL(syscall)(SYS_pidfd_open, pid, 0), .events = POLLIN};
    if (process.fd < 0)
        return errno == ESRCH;
    bool ended = REAL(poll)(&process, 1, 0) > 0;
    REAL(close)(process.fd);
    return ended;
}

static void forget_process(int pid)
{
    for (struct slot *s = S->slots; s < S->slots + S->used; s++)
        if (s->state != FREE && s->pid == pid)
            free_slot(s);
    for (struct process *p = S->processes; p < S->processes + PROCESSES; p++)
        if (p->pid == pid) {
            S->busy -= p->told;
            *p = (struct process){.calls = p->calls};
        }
}

void forget_if_gone(int pid)
{
    lock();
    if (gone(pid))
        forget_process(pid);
    unlock();
}

/* It is busy until its agent answers, or until it is gone: the clock would not wait for the kernel to end it. */
void tell_signalled(int to)
{
    lock();
    for (struct process *p = S->processes; p < S->processes + PROCESSES; p++)
        if (p->pid && p != P && (to > 0 ? p->pid == to : getpgid(p->pid) == (to ? -to : getpgrp())))
            tell(p);
    unlock();
}

/* Called while nothing happens, with the lock: find threads that wait in unknown ways, or that compute for long. */
static void watch(bool idle)
{
    static struct { int tid; long switches; uint32_t waits; int64_t began_ns, passed_ns; } seen[SLOTS];
    int64_t passed_ns = 0;
    for (struct slot *s = S->slots; s < S->slots + S->used; s++) {
        if (s->state == FREE)
            continue;
        if (idle && s->pid != P->pid && gone(s->pid))
            forget_process(s->pid);
        else if (idle && s->state == EXPECTED && real_now() - s->until > EXPECTED_NS)
            free_slot(s);
        if (s->pid != P->pid || s->state != RUNNING || s->tid < 0)
            continue;
        __typeof__(*seen) *before = &seen[s - S->slots];
        int64_t used_ns = real_time(processor_clock(s->tid));
        if (before->tid != s->tid || before->waits != s->waits)
            *before = (__typeof__(*seen)){s->tid, -1, s->waits, used_ns, 0};
        long switches;
        bool sleeps = !s->locking && state_of(s->tid, &switches) == 'S';
        if (sleeps && before->switches == switches) {
            s->state = STRAY;
            S->strays++;
            S->running--;
            S->activity++;
        }
        before->switches = sleeps ? switches : -1;
        int64_t over_ns = used_ns - before->began_ns - BUSY_NS - before->passed_ns;
        if (over_ns > passed_ns)
            passed_ns = over_ns;
        if (over_ns > 0)
            before->passed_ns += over_ns;
        /* a thread of CPython that wants its lock asks for it after 5 ms: of processor time, as our clock stands still */
        for (struct waiter *w = waiters; w && used_ns - before->began_ns > GIL_NS; w = w->next)
            if (w->switching && w->slot->state == WAITING) {
                w->early = true;
                run(w->slot);
                ring(w->slot);
            }
    }
    for (struct waiter *w = waiters; idle && w; w = w->next)
        if (w->shared && w->slot->state == WAITING) {
            run(w->slot);
            ring(w->slot);
        }
    if (passed_ns && S->released)
        set_clock(S->now + passed_ns);
    settle();
}

static void *agent(void *unused)
{
    (void)unused;
    outside = true;
    uint64_t activity = 0;
    int64_t time = 0;
    for (;;) {
        lock();
        if (P->told) {
            P->told = 0;
            if (P->timer <= S->now)
                expire_timers();
            for (struct waiter *w = waiters; w; w = w->next)
                if (w->slot->state == RUNNING && w->n)
                    eventfd_write(w->slot->bell, 1);
            check_descriptors();
            S->busy--;
            settle();
        }
        uint32_t calls = P->calls;
        unlock();
        int64_t pause_ns = S->resume - real_now();
        struct timespec limit = timespec_of(pause_ns > 0 && pause_ns < WATCH_NS ? pause_ns : WATCH_NS);
        if (futex(&P->calls, FUTEX_WAIT, calls, &limit) == 0 || errno != ETIMEDOUT)
            continue;
        static int64_t looked;
        int64_t real = real_now();
        lock();
        if (real - looked >= WATCH_NS) {
            looked = real;
            watch(activity == S->activity && time == S->now);
            activity = S->activity;
            time = S->now;
        } else {
            settle();
        }
        unlock();
    }
    return NULL;
}

static void start_agent(void)
{
    pthread_t thread;
    pthread_attr_t attributes;
    sigset_t all, before;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    pthread_attr_init(&attributes);
    pthread_attr_setdetachstate(&attributes, PTHREAD_CREATE_DETACHED);
    REAL(pthread_create)(&thread, &attributes, agent, NULL);
    pthread_sigmask(SIG_SETMASK, &before, NULL);
}

static struct process *vacancy(void)
{
    for (struct process *p = S->processes; p < S->processes + PROCESSES; p++)
        if (!p->pid)
            return p;
    return NULL;
}

void join_clock(void)
{
    lock();
    P = vacancy();
    if (!P) { /* processes that were killed are noticed while nothing happens, which may be long ago */
        for (struct process *p = S->processes; p < S->processes + PROCESSES; p++)
            if (gone(p->pid))
                forget_process(p->pid);
        P = vacancy();
    }
    if (P) {
        *P = (struct process){.pid = getpid(), .calls = P->calls, .timer = NEVER};
        S->joined++;
    }
    unlock();
    if (!P) {
        fprintf(stderr, "lockstep: more than %d processes\n", PROCESSES);
        abort();
    }
    start_agent();
}

static void thread_ends(void *slot)
{
    lock();
    const void *thread = (const void *)((struct slot *)slot)->thread;
    if (((struct slot *)slot)->pid == P->pid)
        free_slot(slot);
    outside = true;
    wake_key(thread, INT_MAX);
    settle();
    unlock();
}

extern struct real __start_real[], __stop_real[]; /* by the linker: all of that section */

void *look_up(struct real *real) { return real->function = dlsym(RTLD_NEXT, real->name); }

__attribute__((constructor)) static void begin(void)
{
    for (struct real *real = __start_real; real < __stop_real; real++)
        look_up(real);
    const char *path = getenv("UR_LOCKSTEP");
    int fd = path ? open(path, O_RDWR | O_CLOEXEC) : -1;
    if (fd < 0)
        return;
    struct shared *found = mmap(NULL, sizeof *found, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    REAL(close)(fd);
    if (found == MAP_FAILED)
        return;
    uint32_t unborn = 0;
    if (atomic_compare_exchange_strong((_Atomic uint32_t *)&found->born, &unborn, 1)) {
        pthread_mutexattr_t attributes;
        pthread_mutexattr_init(&attributes);
        pthread_mutexattr_setpshared(&attributes, PTHREAD_PROCESS_SHARED);
        pthread_mutexattr_setrobust(&attributes, PTHREAD_MUTEX_ROBUST);
        pthread_mutex_init(&found->lock, &attributes);
        found->real_base = real_time(CLOCK_REALTIME);
        found->monotonic_base = real_time(CLOCK_MONOTONIC);
        found->touched = true;
        atomic_store((_Atomic uint32_t *)&found->born, 2);
    }
    while (atomic_load((_Atomic uint32_t *)&found->born) != 2)
        REAL(sched_yield)();
    pthread_key_create(&ending, thread_ends);
    S = found;
    lock();
    struct slot *slot = new_slot(getpid(), RUNNING);
    for (struct slot *s = S->slots; s < S->slots + S->used; s++) /* of the program that this one has replaced */
        if (s != slot && s->state != FREE && s->pid == getpid())
            free_slot(s);
    for (struct process *p = S->processes; p < S->processes + PROCESSES; p++)
        if (p->pid == getpid()) {
            S->busy -= p->told;
            *p = (struct process){.calls = p->calls};
        }
    unlock();
    register_thread(slot);
    join_clock();
}

void leave(void)
{
    if (!S || outside)
        return;
    lock();
    outside = left = true;
    forget_process(P->pid);
    settle();
    unlock();
}
