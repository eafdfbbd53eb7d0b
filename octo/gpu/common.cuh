/* Words that all kernels share. Every loop over EACH is block-stride: any number of threads gives the same numbers. */

#pragma once

#ifdef OCTO_ON_CPU
#define SHARED(name) double *name = (double *)cuda_on_cpu_here->shared
#else
#define SHARED(name) extern __shared__ double name[]
#endif

#ifndef NAN
#define NAN __longlong_as_double(0x7ff8000000000000LL)
#define INFINITY __longlong_as_double(0x7ff0000000000000LL)
#endif

#ifndef LANE
#define LANE ((int)threadIdx.x)
#define LANES ((int)blockDim.x)
#define BARRIER __syncthreads()
#endif

#ifndef EACH
#define EACH(e, count) for (int e = LANE; e < (count); e += LANES)
#endif

/* Members of a batch that a launch leaves as they are: active (batch), or none to work on all of them. */
#define ONLY(active, member) if ((active) && !(active)[member]) return

/* Sums over a block have PARTS parts whatever the number of threads: their rounding is always the same. */
#define PARTS 128

static __device__ inline double octo_block_sum(double *part) { /* of part (PARTS), shared, written before; read after */
  BARRIER;
  EACH(k, PARTS / 16) {
    double sum = 0.0;
    for (int j = 0; j < 16; ++j) sum += part[16 * k + j];
    part[16 * k] = sum;
  }
  BARRIER;
  double sum = 0.0;
  for (int k = 0; k < PARTS / 16; ++k) sum += part[16 * k];
  BARRIER;
  return sum;
}

/* The same of maxima; a NaN anywhere is the maximum, as in NumPy. */
static __device__ inline double octo_larger(double a, double b) { return (a != a) | (a > b) ? a : b; }

static __device__ inline double octo_block_max(double *part) {
  BARRIER;
  EACH(k, PARTS / 16) {
    double top = 0.0;
    for (int j = 0; j < 16; ++j) top = octo_larger(part[16 * k + j], top);
    part[16 * k] = top;
  }
  BARRIER;
  double top = 0.0;
  for (int k = 0; k < PARTS / 16; ++k) top = octo_larger(part[16 * k], top);
  BARRIER;
  return top;
}
