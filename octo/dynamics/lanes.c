/* STEPS time steps at a time, one in every lane of a vector: what tree.c and the text of emit.py need for that, before them.
 *
 * ``real`` is the vector, ``double`` a number that all lanes share. No lane sees another: each has the bits that it would
 * have beside any other steps. */

#if defined(__AVX512F__)
#define STEPS 8
#define OCTO_LANES(from, s) from(0, s), from(1, s), from(2, s), from(3, s), from(4, s), from(5, s), from(6, s), from(7, s)
#elif defined(__AVX__)
#define STEPS 4
#define OCTO_LANES(from, s) from(0, s), from(1, s), from(2, s), from(3, s)
#else
#define STEPS 2
#define OCTO_LANES(from, s) from(0, s), from(1, s)
#endif

typedef double real __attribute__((vector_size(8 * STEPS)));
typedef double octo_real_anywhere __attribute__((vector_size(8 * STEPS), aligned(8), may_alias));
typedef long long octo_mask __attribute__((vector_size(8 * STEPS)));
#define ZERO ((real){0})
#define NOT(mask) (~(mask))
#define ANY(mask) octo_any(mask)
#define WHERE(mask, value) ((real)((mask) & (octo_mask)(value)))
#define ARGUMENT void
#define STAGE(name, arg, res) name((const void *const *)(arg), res)

#ifdef __clang__
#define OCTO_SHUFFLE(a, b, from, s) __builtin_shufflevector(a, b, OCTO_LANES(from, s))
#else
#define OCTO_SHUFFLE(a, b, from, s) __builtin_shuffle(a, b, (octo_mask){OCTO_LANES(from, s)})
#endif

static inline int octo_any(octo_mask mask) {
  long long any = 0;
  for (int k = 0; k < STEPS; ++k) any |= mask[k];
  return any != 0;
}

static inline real octo_fabs(real x) { return (real)((octo_mask)x & 0x7fffffffffffffffLL); }
static inline real octo_pick(octo_mask mask, real one, real other) { return (real)((mask & (octo_mask)one) | (~mask & (octo_mask)other)); }
static inline real octo_fmax(real a, real b) { return octo_pick((a >= b) | (b != b), a, b); } /* of a NaN and a number: the number */
static inline real octo_fmin(real a, real b) { return octo_pick((a <= b) | (b != b), a, b); }
static inline real octo_sign(real x) { return WHERE(x > 0.0, ZERO + 1.0) - WHERE(x < 0.0, ZERO + 1.0) + WHERE(x != x, x); }

#define OCTO_OF_ONE(name) static inline real octo_##name(real x) { for (int k = 0; k < STEPS; ++k) x[k] = name(x[k]); return x; }
#define OCTO_OF_TWO(name) \
  static inline real octo_##name(real x, real y) { for (int k = 0; k < STEPS; ++k) x[k] = name(x[k], y[k]); return x; }
OCTO_OF_ONE(sqrt) OCTO_OF_ONE(tan) OCTO_OF_ONE(asin) OCTO_OF_ONE(acos) OCTO_OF_ONE(atan)
OCTO_OF_ONE(sinh) OCTO_OF_ONE(cosh) OCTO_OF_ONE(tanh) OCTO_OF_ONE(asinh) OCTO_OF_ONE(acosh) OCTO_OF_ONE(atanh)
OCTO_OF_ONE(exp) OCTO_OF_ONE(expm1) OCTO_OF_ONE(log) OCTO_OF_ONE(log1p) OCTO_OF_ONE(erf)
OCTO_OF_ONE(floor) OCTO_OF_ONE(ceil)
OCTO_OF_TWO(pow) OCTO_OF_TWO(atan2) OCTO_OF_TWO(fmod) OCTO_OF_TWO(copysign) OCTO_OF_TWO(hypot)

static __attribute__((noinline)) void octo_sincos_beyond(const real *angle, const octo_mask *beyond, real *sine, real *cosine) {
  for (int k = 0; k < STEPS; ++k)
    if ((*beyond)[k]) { (*sine)[k] = sin((*angle)[k]); (*cosine)[k] = cos((*angle)[k]); }
}

/* Sine and cosine as in fdlibm, after a reduction by multiples of π/2; lanes of large angles are libm's. */
static inline void octo_sincos(real angle, real *sine, real *cosine) {
  const double shift = 0x1.8p52, large = 1e5;
  real turns = angle * 0.63661977236758134308 + shift;
  octo_mask quarter = (octo_mask)turns;
  turns -= shift;
  real r = angle - turns * 1.57079632673412561417e+00 - turns * 6.07710050650619224932e-11, z = r * r;
  real s = r + r * z * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04
         + z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
  real half = 0.5 * z, w = 1.0 - half;
  real c = w + (((1.0 - w) - half) + z * z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03
         + z * (2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09
         + z * -1.13596475577881948265e-11))))));
  octo_mask odd = (quarter & 1) != 0;
  *sine = (real)((octo_mask)octo_pick(odd, c, s) ^ ((quarter & 2) << 62));
  *cosine = (real)((octo_mask)octo_pick(odd, s, c) ^ (((quarter + 1) & 2) << 62));
  octo_mask beyond = ~(octo_fabs(angle) < large);
  if (octo_any(beyond)) octo_sincos_beyond(&angle, &beyond, sine, cosine);
}

static inline real octo_sin(real angle) { real sine, cosine; octo_sincos(angle, &sine, &cosine); return sine; }
static inline real octo_cos(real angle) { real sine, cosine; octo_sincos(angle, &sine, &cosine); return cosine; }

/* STEPS numbers of each of STEPS steps, to STEPS vectors, or back. */
#define OCTO_LOWER(k, s) ((k) & (s) ? (k) - (s) + STEPS : (k))
#define OCTO_UPPER(k, s) ((k) & (s) ? (k) + STEPS : (k) + (s))
#define OCTO_SWAP(s) \
  for (int k = 0; k < STEPS; ++k) \
    if (!(k & s)) { \
      real a = v[k], b = v[k + s]; \
      v[k] = OCTO_SHUFFLE(a, b, OCTO_LOWER, s); \
      v[k + s] = OCTO_SHUFFLE(a, b, OCTO_UPPER, s); \
    }
static inline __attribute__((always_inline)) void octo_transpose(real *v) {
  OCTO_SWAP(1)
#if STEPS > 2
  OCTO_SWAP(2)
#endif
#if STEPS > 4
  OCTO_SWAP(4)
#endif
}

/* ``size`` numbers of every step into vectors. */
static inline void octo_gather(const double *const *from, int size, real *to) {
  int e = 0;
  for (; e + STEPS <= size; e += STEPS) {
    real v[STEPS];
    for (int k = 0; k < STEPS; ++k) v[k] = *(const octo_real_anywhere *)(from[k] + e);
    octo_transpose(v);
    for (int k = 0; k < STEPS; ++k) to[e + k] = v[k];
  }
  for (; e < size; ++e)
    for (int k = 0; k < STEPS; ++k) to[e][k] = from[k][e];
}

/* ``size`` vectors to the first ``count`` steps. */
static inline void octo_spread(const real *from, int size, double *const *to, int count) {
  int e = 0;
  for (; e + STEPS <= size; e += STEPS) {
    real v[STEPS];
    for (int k = 0; k < STEPS; ++k) v[k] = from[e + k];
    octo_transpose(v);
    for (int k = 0; k < count; ++k) *(octo_real_anywhere *)(to[k] + e) = v[k];
  }
  for (; e < size; ++e)
    for (int k = 0; k < count; ++k) to[k][e] = from[e][k];
}

/* The same of the nodes that follow by s: those of ``a``, then those of ``b``. */
#define OCTO_AFTER(k, s) ((k) + (s))
static inline void octo_following(const real *a, const real *b, int size, real *one, real *two) {
  for (int e = 0; e < size; ++e) {
    one[e] = OCTO_SHUFFLE(a[e], b[e], OCTO_AFTER, 1);
    two[e] = OCTO_SHUFFLE(a[e], b[e], OCTO_AFTER, 2);
  }
}
