/* CUDA's words for a C++ compiler: a kernel of octo is executed on the CPU from the very text that NVRTC compiles.
 *
 * Under a sanitizer the threads of a block are POSIX threads and __syncthreads is a pthread_barrier_t, so that
 * ThreadSanitizer sees what CUDA would race on. Otherwise they take turns on one processor, the last one first, and go on
 * up to the next barrier, which takes a fiftieth of the time. Several blocks run at the same time, each with threads, a barrier
 * and shared memory of its own
 * (exactly as many bytes as the launch asks for, so that AddressSanitizer sees an overrun; filled with NaN before every
 * block, for CUDA does not clear it either). Blocks beyond those take their turns. Nothing here is fast. */

#pragma once
#include <math.h>
#include <pthread.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <setjmp.h>
#include <string.h>
#include <sys/mman.h>
#include <ucontext.h>

#include <type_traits>
#include <utility>
#include <vector>

#define __CUDACC_RTC__ 1
#define OCTO_ON_CPU 1
#define __global__
#define __device__
#define __forceinline__ inline
#define __launch_bounds__(...)
#define __restrict__
#define __align__(bytes) __attribute__((aligned(bytes)))

struct cuda_on_cpu_index { unsigned x, y, z; };
#if defined(__SANITIZE_THREAD__) || defined(__SANITIZE_ADDRESS__)
#define CUDA_ON_CPU_POSIX 1
#endif

struct cuda_on_cpu_crew;

static thread_local cuda_on_cpu_index threadIdx, blockIdx;
static thread_local cuda_on_cpu_crew *cuda_on_cpu_here;
static cuda_on_cpu_index blockDim, gridDim;

/* Two barriers take turns: with one, a POSIX thread that wakes late would learn from it what others did up to their next wait, and
 * ThreadSanitizer would take that for an order between them. */
static thread_local int cuda_on_cpu_turn, cuda_on_cpu_warp_turn;

#ifdef CUDA_ON_CPU_POSIX
struct cuda_on_cpu_barrier {
  pthread_barrier_t own;
  void init(unsigned size) { pthread_barrier_init(&own, 0, size); }
  void wait() { pthread_barrier_wait(&own); }
  ~cuda_on_cpu_barrier() { pthread_barrier_destroy(&own); }
};
#else
/* A thread that takes turns with the others of a launch, on a stack of its own. */
struct cuda_on_cpu_turns { ucontext_t begin; jmp_buf here; bool begun, ended; };
static std::vector<cuda_on_cpu_turns> cuda_on_cpu_all;
static size_t cuda_on_cpu_now;
static ucontext_t cuda_on_cpu_caller;

static void cuda_on_cpu_next() {
  size_t count = cuda_on_cpu_all.size(), next = cuda_on_cpu_now;
  for (size_t k = 0; k < count; ++k) {
    next = (next + count - 1) % count;
    if (!cuda_on_cpu_all[next].ended) break;
  }
  cuda_on_cpu_turns &other = cuda_on_cpu_all[next];
  if (other.ended) setcontext(&cuda_on_cpu_caller);
  cuda_on_cpu_now = next;
  if (other.begun) _longjmp(other.here, 1);
  other.begun = true;
  setcontext(&other.begin);
}

struct cuda_on_cpu_barrier {
  unsigned size, arrived, round;
  void init(unsigned threads) { size = threads, arrived = round = 0; }
  __attribute__((noinline)) void wait() { /* a call, not code at every barrier of a kernel: compiling takes half */
    unsigned before = round;
    if (++arrived == size) {
      arrived = 0, ++round;
      return;
    }
    const cuda_on_cpu_index thread = threadIdx, block = blockIdx;
    const int turn = cuda_on_cpu_turn, warp_turn = cuda_on_cpu_warp_turn;
    cuda_on_cpu_crew *const crew = cuda_on_cpu_here;
    while (*(volatile unsigned *)&round == before)
      if (!_setjmp(cuda_on_cpu_all[cuda_on_cpu_now].here)) cuda_on_cpu_next();
    threadIdx = thread, blockIdx = block, cuda_on_cpu_here = crew;
    cuda_on_cpu_turn = turn, cuda_on_cpu_warp_turn = warp_turn;
  }
};
#endif

struct cuda_on_cpu_warp { cuda_on_cpu_barrier barrier[2]; unsigned slot[32]; };
struct cuda_on_cpu_crew { cuda_on_cpu_barrier barrier[2]; int threads; char *shared; std::vector<cuda_on_cpu_warp> warps; std::vector<int> flags; };

static inline void __syncthreads() {
  if (cuda_on_cpu_here->threads > 1) cuda_on_cpu_here->barrier[cuda_on_cpu_turn ^= 1].wait();
}

static inline int __syncthreads_or(int flag) {
  std::vector<int> &flags = cuda_on_cpu_here->flags;
  flags[threadIdx.x] = flag;
  __syncthreads();
  int any = 0;
  for (int one : flags) any |= one;
  __syncthreads();
  return any != 0;
}

#ifdef __SANITIZE_THREAD__
/* A warp agrees on a number, which orders nothing else: ThreadSanitizer must not take it for more. */
extern "C" void AnnotateIgnoreSyncBegin(const char *, int), AnnotateIgnoreSyncEnd(const char *, int),
    AnnotateIgnoreReadsBegin(const char *, int), AnnotateIgnoreReadsEnd(const char *, int), AnnotateIgnoreWritesBegin(const char *, int),
    AnnotateIgnoreWritesEnd(const char *, int);
struct cuda_on_cpu_unordered {
  cuda_on_cpu_unordered() { AnnotateIgnoreSyncBegin("", 0), AnnotateIgnoreReadsBegin("", 0), AnnotateIgnoreWritesBegin("", 0); }
  ~cuda_on_cpu_unordered() { AnnotateIgnoreWritesEnd("", 0), AnnotateIgnoreReadsEnd("", 0), AnnotateIgnoreSyncEnd("", 0); }
};
#else
struct cuda_on_cpu_unordered { cuda_on_cpu_unordered() {} };
#endif

/* The largest value of a warp, the last of which may have fewer threads than 32 here. */
static inline unsigned __reduce_max_sync(unsigned, unsigned value) {
  int first = (int)threadIdx.x / 32 * 32, size = cuda_on_cpu_here->threads - first < 32 ? cuda_on_cpu_here->threads - first : 32;
  if (size == 1) return value;
  cuda_on_cpu_unordered here;
  cuda_on_cpu_warp &warp = cuda_on_cpu_here->warps[first / 32];
  warp.slot[threadIdx.x - first] = value;
  warp.barrier[cuda_on_cpu_warp_turn ^= 1].wait();
  for (int k = 0; k < size; ++k) value = warp.slot[k] > value ? warp.slot[k] : value;
  warp.barrier[cuda_on_cpu_warp_turn ^= 1].wait();
  return value;
}

static inline long long __double_as_longlong(double value) { long long bits; memcpy(&bits, &value, 8); return bits; }
static inline double __longlong_as_double(long long bits) { double value; memcpy(&value, &bits, 8); return value; }

/* What a launch is told: grid and block (3 each), bytes of shared memory, blocks at the same time. */
struct cuda_on_cpu_launch { unsigned grid[3], threads; unsigned long shared; unsigned crews; };

typedef void (*cuda_on_cpu_kernel)(void **arguments); /* no template below knows a kernel: each would be compiled for each */
struct cuda_on_cpu_worker { const cuda_on_cpu_launch *launch; cuda_on_cpu_kernel kernel; void **arguments; cuda_on_cpu_crew *crew; unsigned crew_number, lane; };

static void *cuda_on_cpu_work(void *argument) {
  const auto *me = (const cuda_on_cpu_worker *)argument;
  const cuda_on_cpu_launch *l = me->launch;
  unsigned long blocks = (unsigned long)l->grid[0] * l->grid[1] * l->grid[2];
  cuda_on_cpu_here = me->crew;
  threadIdx = {me->lane, 0, 0};
  cuda_on_cpu_turn = cuda_on_cpu_warp_turn = 0;
  for (unsigned long b = me->crew_number; b < blocks; b += l->crews) {
    blockIdx = {(unsigned)(b % l->grid[0]), (unsigned)(b / l->grid[0] % l->grid[1]), (unsigned)(b / l->grid[0] / l->grid[1])};
    if (me->lane == 0 && l->shared) memset(me->crew->shared, 0xff, l->shared);
    __syncthreads();
    me->kernel(me->arguments);
    __syncthreads();
  }
  return 0;
}

#ifdef CUDA_ON_CPU_POSIX
static int cuda_on_cpu_all_of(std::vector<cuda_on_cpu_worker> &workers) {
  std::vector<pthread_t> handles(workers.size());
  for (size_t k = 0; k < workers.size(); ++k)
    if (pthread_create(&handles[k], 0, cuda_on_cpu_work, &workers[k])) abort(); /* the others wait at a barrier for ever */
  for (auto &handle : handles) pthread_join(handle, 0);
  return 0;
}
#else
static void cuda_on_cpu_begin(unsigned high, unsigned low) {
  cuda_on_cpu_work((void *)((uintptr_t)high << 32 | low));
  cuda_on_cpu_all[cuda_on_cpu_now].ended = true;
  cuda_on_cpu_next();
}

static int cuda_on_cpu_all_of(std::vector<cuda_on_cpu_worker> &workers) {
  const size_t stack = (size_t)8 << 20, bytes = stack * workers.size(); /* a POSIX thread's, of which pages that are touched count */
  char *stacks = (char *)mmap(0, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE | MAP_STACK, -1, 0);
  if (stacks == MAP_FAILED) return 1;
  cuda_on_cpu_all = std::vector<cuda_on_cpu_turns>(workers.size());
  for (size_t k = 0; k < workers.size(); ++k) {
    ucontext_t &begin = cuda_on_cpu_all[k].begin;
    uintptr_t worker = (uintptr_t)&workers[k];
    getcontext(&begin);
    begin.uc_stack.ss_sp = stacks + k * stack, begin.uc_stack.ss_size = stack, begin.uc_link = 0;
    makecontext(&begin, (void (*)())cuda_on_cpu_begin, 2, (unsigned)(worker >> 32), (unsigned)worker);
  }
  volatile bool done = false;
  cuda_on_cpu_now = 0; /* whose turn comes last */
  getcontext(&cuda_on_cpu_caller);
  if (!done) {
    done = true;
    cuda_on_cpu_next();
  }
  munmap(stacks, bytes);
  return 0;
}
#endif

static int cuda_on_cpu_run(const cuda_on_cpu_launch *l, cuda_on_cpu_kernel kernel, void **arguments) {
  blockDim = {l->threads, 1, 1};
  gridDim = {l->grid[0], l->grid[1], l->grid[2]};
  std::vector<cuda_on_cpu_crew> crews(l->crews);
  std::vector<cuda_on_cpu_worker> workers;
  int failed = 0;
  for (auto &crew : crews) {
    crew.threads = (int)l->threads;
    crew.shared = (char *)malloc(l->shared + !l->shared);
    for (auto &barrier : crew.barrier) barrier.init(l->threads);
    crew.flags = std::vector<int>(l->threads);
    crew.warps = std::vector<cuda_on_cpu_warp>((l->threads + 31) / 32);
    for (unsigned first = 0; first < l->threads; first += 32)
      for (auto &barrier : crew.warps[first / 32].barrier) barrier.init(l->threads - first < 32 ? l->threads - first : 32);
  }
  for (unsigned c = 0; c < l->crews; ++c)
    for (unsigned lane = 0; lane < l->threads; ++lane) workers.push_back({l, kernel, arguments, &crews[c], c, lane});
  if (workers.size() == 1) {
    cuda_on_cpu_work(&workers[0]);
  } else {
    failed = cuda_on_cpu_all_of(workers);
  }
  for (auto &crew : crews) free(crew.shared);
  return failed;
}

/* One letter an argument: d, f and i for double, float and int; capitals for pointers to them. */
template <typename T> static char cuda_on_cpu_letter() {
  using V = std::remove_cv_t<std::remove_pointer_t<T>>;
  char letter = std::is_same_v<V, double> ? 'd' : std::is_same_v<V, float> ? 'f' : std::is_same_v<V, int> ? 'i' : '?';
  return std::is_pointer_v<T> && letter != '?' ? (char)(letter - 32) : letter;
}

template <typename... T> static const char *cuda_on_cpu_signature(void (*)(T...)) {
  static const char letters[] = {cuda_on_cpu_letter<T>()..., 0};
  return letters;
}

template <typename... T, size_t... k>
static void cuda_on_cpu_call(void (*kernel)(T...), void **arguments, std::index_sequence<k...>) {
  kernel(*(T *)arguments[k]...);
}

template <typename... T> static void cuda_on_cpu_start(void (*kernel)(T...), void **arguments) {
  cuda_on_cpu_call(kernel, arguments, std::index_sequence_for<T...>());
}

#define CUDA_ON_CPU_ENTRY(kernel) \
  extern "C" const char *signature_of_##kernel() { return cuda_on_cpu_signature(kernel); } \
  static void start_of_##kernel(void **arguments) { cuda_on_cpu_start(kernel, arguments); } \
  extern "C" int launch_of_##kernel(const cuda_on_cpu_launch *l, void **arguments) { return cuda_on_cpu_run(l, start_of_##kernel, arguments); }
