/* The threads of all native code, a pool for each library: whoever comes first takes the next item. Helpers sleep between
 * calls, and nobody waits for one that a busy machine wakes late: it finds nothing left to do. So a call is right with any
 * number of helpers, also with none, as after a fork. One call at a time has them; another at the same time works alone. */

#include <pthread.h>
#include <sched.h>
#include <semaphore.h>
#include <stddef.h>
#include <stdint.h>
#include <unistd.h>

#define MOST_ITEMS (1 << 24)
#define MOST_HELPERS 63

static struct {
  uint64_t word; /* of the call at hand: its number (16 bits), its items (24), the next one (24), changed as one */
  void (*run)(void *, int);
  void *shared;
  int done, busy, helpers;
  pid_t process;
  sem_t wake;
} octo_pool;

/* ``run`` and ``shared`` are those of an item taken: the caller stays until all of its items are done. */
static void octo_take_items(void) {
  uint64_t word = __atomic_load_n(&octo_pool.word, __ATOMIC_ACQUIRE);
  for (;;) {
    int items = (int)(word >> 24 & (MOST_ITEMS - 1)), item = (int)(word & (MOST_ITEMS - 1));
    if (item >= items) return;
    if (!__atomic_compare_exchange_n(&octo_pool.word, &word, word + 1, 0, __ATOMIC_ACQ_REL, __ATOMIC_ACQUIRE)) continue;
    octo_pool.run(octo_pool.shared, item);
    __atomic_add_fetch(&octo_pool.done, 1, __ATOMIC_RELEASE);
    word = __atomic_load_n(&octo_pool.word, __ATOMIC_ACQUIRE);
  }
}

static void *octo_help(void *nothing) {
  for (;;)
    if (sem_wait(&octo_pool.wake) == 0) octo_take_items();
  return nothing;
}

static void octo_wake_helpers(int wanted) {
  if (octo_pool.process != getpid()) {
    octo_pool.process = getpid();
    octo_pool.helpers = 0;
    sem_init(&octo_pool.wake, 0, 0);
  }
  for (pthread_t handle; octo_pool.helpers < wanted && octo_pool.helpers < MOST_HELPERS; ++octo_pool.helpers) {
    if (pthread_create(&handle, 0, octo_help, 0)) break;
    pthread_detach(handle);
  }
  for (int k = 0; k < wanted && k < octo_pool.helpers; ++k) sem_post(&octo_pool.wake);
}

static void octo_parallel_for(void (*run)(void *, int), void *shared, int items, int threads) {
  int wanted = (threads < items ? threads : items) - 1;
  if (wanted < 1 || items >= MOST_ITEMS || __atomic_exchange_n(&octo_pool.busy, 1, __ATOMIC_ACQUIRE)) {
    for (int item = 0; item < items; ++item) run(shared, item);
    return;
  }
  octo_pool.run = run, octo_pool.shared = shared, octo_pool.done = 0;
  uint64_t number = (octo_pool.word >> 48) + 1;
  __atomic_store_n(&octo_pool.word, number << 48 | (uint64_t)items << 24, __ATOMIC_RELEASE);
  octo_wake_helpers(wanted);
  octo_take_items();
  for (int spins = 0; __atomic_load_n(&octo_pool.done, __ATOMIC_ACQUIRE) < items; ++spins)
    if (spins > 2000) sched_yield();
  __atomic_store_n(&octo_pool.busy, 0, __ATOMIC_RELEASE);
}

/* The same for items that need memory of their own: run(shared, item, worker), of a worker number below ``threads`` one at a
 * time. A worker is an item of the pool that takes items of the call until none is left. */
typedef struct {
  void (*run)(const void *, ptrdiff_t, int);
  const void *shared;
  ptrdiff_t next, items;
} octo_workers;

static void octo_work_through(void *shared, int worker) {
  octo_workers *w = shared;
  for (ptrdiff_t item; (item = __atomic_fetch_add(&w->next, 1, __ATOMIC_RELAXED)) < w->items;) w->run(w->shared, item, worker);
}

static void octo_parallel_for_workers(void (*run)(const void *, ptrdiff_t, int), const void *shared, ptrdiff_t items, int threads) {
  octo_workers workers = {run, shared, 0, items};
  octo_parallel_for(octo_work_through, &workers, threads < items ? threads : (int)items, threads);
}
