/* A thread that shares one member's work with the thread that solves it. */
#include <pthread.h>
#include <sched.h>
#include <stdlib.h>

/* A thread that may run side 1 of a phase while its owner runs side 0. Whoever comes first claims side 1: a companion
 * that a busy machine starts late costs nothing but its start. Kept on the heap, because it may outlive its owner. */
typedef struct {
    void (*run)(void *, int);        /* NULL ends the companion */
    void *shared;
    int state, done, holders;        /* state: even, phase on offer; odd, phase claimed */
} companion;

static void companion_release(companion *c) {
    if (__atomic_sub_fetch(&c->holders, 1, __ATOMIC_ACQ_REL) == 0) free(c);
}

static int claim(companion *c, int phase) {
    return __atomic_compare_exchange_n(&c->state, &phase, phase + 1, 0, __ATOMIC_ACQ_REL, __ATOMIC_ACQUIRE);
}

/* phases are microseconds: spin, then let others run */
static void pause_at(int *spins) {
    if (++*spins > 2000) sched_yield();
}

static void *accompany(void *argument) {
    companion *c = argument;
    for (int spins = 0;;) {
        int phase = __atomic_load_n(&c->state, __ATOMIC_ACQUIRE);
        if (phase == 0 || phase % 2 || !claim(c, phase)) {
            pause_at(&spins);
            continue;
        }
        if (!c->run) break;
        c->run(c->shared, 1);
        __atomic_store_n(&c->done, phase, __ATOMIC_RELEASE);
        spins = 0;
    }
    companion_release(c);
    return NULL;
}

/* NULL where none is wanted or can be had */
static companion *companion_start(int wanted) {
    companion *c = wanted ? calloc(1, sizeof *c) : NULL;
    pthread_t handle;
    if (!c) return NULL;
    c->holders = 2;
    if (pthread_create(&handle, NULL, accompany, c)) {
        free(c);
        return NULL;
    }
    pthread_detach(handle);
    return c;
}

static int offer(companion *c, void (*run)(void *, int), void *shared) {
    int phase = __atomic_load_n(&c->state, __ATOMIC_RELAXED) / 2 * 2 + 2;
    c->run = run, c->shared = shared;
    __atomic_store_n(&c->state, phase, __ATOMIC_RELEASE);
    return phase;
}

/* both sides of a phase; without a companion one after the other */
static void both(companion *c, void (*run)(void *, int), void *shared) {
    int phase = c ? offer(c, run, shared) : 0, spins = 0;
    run(shared, 0);
    if (!c || claim(c, phase)) run(shared, 1);
    else
        while (__atomic_load_n(&c->done, __ATOMIC_ACQUIRE) != phase) pause_at(&spins);
}

static void companion_stop(companion *c) {
    if (!c) return;
    offer(c, NULL, NULL);
    companion_release(c);
}
