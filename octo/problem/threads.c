/* Items over threads: whoever comes first takes the next one. Helpers sleep between calls, and nobody waits for one that
 * a busy machine wakes late: it finds nothing left to do. So a call is right with any number of helpers, also with none,
 * as after a fork. One call at a time has them; another at the same time works alone. */

#include <pthread.h>
#include <sched.h>
#include <semaphore.h>
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
} octo_crowd;

/* ``run`` and ``shared`` are those of an item taken: the caller stays until all of its items are done. */
static void octo_take_items(void) {
  uint64_t word = __atomic_load_n(&octo_crowd.word, __ATOMIC_ACQUIRE);
  for (;;) {
    int items = (int)(word >> 24 & (MOST_ITEMS - 1)), item = (int)(word & (MOST_ITEMS - 1));
    if (item >= items) return;
    if (!__atomic_compare_exchange_n(&octo_crowd.word, &word, word + 1, 0, __ATOMIC_ACQ_REL, __ATOMIC_ACQUIRE)) continue;
    octo_crowd.run(octo_crowd.shared, item);
    __atomic_add_fetch(&octo_crowd.done, 1, __ATOMIC_RELEASE);
    word = __atomic_load_n(&octo_crowd.word, __ATOMIC_ACQUIRE);
  }
}

static void *octo_help(void *nothing) {
  for (;;)
    if (sem_wait(&octo_crowd.wake) == 0) octo_take_items();
  return nothing;
}

static void octo_wake_helpers(int wanted) {
  if (octo_crowd.process != getpid()) {
    octo_crowd.process = getpid();
    octo_crowd.helpers = 0;
    sem_init(&octo_crowd.wake, 0, 0);
  }
  for (pthread_t handle; octo_crowd.helpers < wanted && octo_crowd.helpers < MOST_HELPERS; ++octo_crowd.helpers) {
    if (pthread_create(&handle, 0, octo_help, 0)) break;
    pthread_detach(handle);
  }
  for (int k = 0; k < wanted && k < octo_crowd.helpers; ++k) sem_post(&octo_crowd.wake);
}

static void octo_share(void (*run)(void *, int), void *shared, int items, int threads) {
  int wanted = (threads < items ? threads : items) - 1;
  if (wanted < 1 || items >= MOST_ITEMS || __atomic_exchange_n(&octo_crowd.busy, 1, __ATOMIC_ACQUIRE)) {
    for (int item = 0; item < items; ++item) run(shared, item);
    return;
  }
  octo_crowd.run = run, octo_crowd.shared = shared, octo_crowd.done = 0;
  uint64_t number = (octo_crowd.word >> 48) + 1;
  __atomic_store_n(&octo_crowd.word, number << 48 | (uint64_t)items << 24, __ATOMIC_RELEASE);
  octo_wake_helpers(wanted);
  octo_take_items();
  for (int spins = 0; __atomic_load_n(&octo_crowd.done, __ATOMIC_ACQUIRE) < items; ++spins)
    if (spins > 2000) sched_yield();
  __atomic_store_n(&octo_crowd.busy, 0, __ATOMIC_RELEASE);
}
