/* W particles in one vector: memory, choice, and the elementary functions.

   GCC and Clang translate these vectors for every machine, ARM included; another compiler handles one particle at a
   time. The functions are Taylor series after exact range reduction, good to 1e-15. The reductions add and subtract a
   number so large that the sum has no fraction: -ffast-math would remove that, hence -fno-fast-math; and no product is
   contracted with a sum (-ffp-contract=off), so that all machines give the same numbers. */
#ifndef USBLDR_LANES_H
#define USBLDR_LANES_H
#include <math.h>
#include <stdint.h>
#include <string.h>
#ifdef __FAST_MATH__
#error "-ffast-math would break the range reductions"
#endif

#if defined(__GNUC__) && !defined(ONE_AT_A_TIME) /* the macro is for a test of the other branch */
typedef double V __attribute__((vector_size(8 * W)));
typedef int64_t I __attribute__((vector_size(8 * W)));
typedef uint64_t Unsigned __attribute__((vector_size(8 * W)));
typedef double InMemory __attribute__((vector_size(8 * W), aligned(8), may_alias));
#define INLINE static inline __attribute__((always_inline, unused))
INLINE I bits(V x) { return (I)x; }
INLINE V of_bits(I x) { return (V)x; }
INLINE I less(V a, V b) { return (I)(a < b); }
INLINE V all(double x) { return (V){0} + x; }
INLINE int any(I mask) { int64_t found = 0; for (int l = 0; l < W; l++) found |= mask[l]; return found != 0; }
INLINE V root(V x) { V r; for (int l = 0; l < W; l++) r[l] = sqrt(x[l]); return r; }
INLINE double first_of(V x) { return x[0]; }
#else
#undef W
#define W 1
typedef double V;
typedef int64_t I;
typedef uint64_t Unsigned;
typedef double InMemory;
#define INLINE static inline
INLINE I bits(V x) { I r; memcpy(&r, &x, 8); return r; }
INLINE V of_bits(I x) { V r; memcpy(&r, &x, 8); return r; }
INLINE I less(V a, V b) { return -(I)(a < b); }
INLINE V all(double x) { return x; }
INLINE int any(I mask) { return mask != 0; }
INLINE V root(V x) { return sqrt(x); }
INLINE double first_of(V x) { return x; }
#endif

#define AT(p, i) (*(InMemory *)((p) + LANES * (i)))  /* number i of W particles of a block */
#define NEXT(p, i) (*(InMemory *)((p) + W * (i)))    /* number i of W particles of the scratch memory */

INLINE V pick(I mask, V a, V b) { return of_bits((bits(a) & mask) | (bits(b) & ~mask)); }

static const double ROUND = 0x1.8p52; /* a double this large has no fraction; its lowest bits are the integer */
static const double LN2 = 0x1.62e42fefa3800p-1, LN2_REST = 0x1.ef35793c76730p-45;
static const double QUARTER = 0x1.921fb544p+0, QUARTER_2 = 0x1.0b4611a6p-34, QUARTER_3 = 0x1.3198a2e037073p-69;

/* 1 / k!; the same of odd and of even k with alternating signs; 1 / (2 k + 1). */
static const double EXP[] = {1.0, 1.0, 1.0 / 2, 1.0 / 6, 1.0 / 24, 1.0 / 120, 1.0 / 720, 1.0 / 5040, 1.0 / 40320,
    1.0 / 362880, 1.0 / 3628800, 1.0 / 39916800, 1.0 / 479001600, 1.0 / 6227020800};
static const double SIN[] = {1.0, -1.0 / 6, 1.0 / 120, -1.0 / 5040, 1.0 / 362880, -1.0 / 39916800, 1.0 / 6227020800,
    -1.0 / 1307674368000, 1.0 / 355687428096000};
static const double COS[] = {1.0, -1.0 / 2, 1.0 / 24, -1.0 / 720, 1.0 / 40320, -1.0 / 3628800, 1.0 / 479001600,
    -1.0 / 87178291200, 1.0 / 20922789888000, -1.0 / 6402373705728000};
static const double ATANH[] = {1.0, 1.0 / 3, 1.0 / 5, 1.0 / 7, 1.0 / 9, 1.0 / 11, 1.0 / 13, 1.0 / 15, 1.0 / 17,
    1.0 / 19, 1.0 / 21, 1.0 / 23};

/* c_0 + c_1 x + ... in two chains, even and odd powers, that the processor computes side by side. */
INLINE V series(const double *c, int count, V x) {
    V square = x * x, even = all(0.0), odd = all(0.0);
    for (int term = count - 1; term >= 0; term--) {
        if (term % 2) odd = c[term] + square * odd;
        else even = c[term] + square * even;
    }
    return even + x * odd;
}

/* e^x for x from -700 (smaller ones are taken as that) to 700: x = k ln 2 + r, e^r by 14 terms. */
INLINE V exponential(V x) {
    x = pick(less(x, all(-700.0)), all(-700.0), x);
    V shifted = x * 1.4426950408889634 + ROUND, k = shifted - ROUND;
    V r = (x - k * LN2) - k * LN2_REST;
    return of_bits(bits(series(EXP, 14, r)) + (bits(shifted) << 52));
}

/* log x: x = 2^e m, m from sqrt(1/2) to sqrt(2); log m = 2 atanh s, s = (m - 1) / (m + 1). NaN if x < 0. */
INLINE V logarithm(V x) {
    const I one = bits(all(1.0)), two_52 = bits(all(0x1p52));
    V e = of_bits((I)((Unsigned)bits(x) >> 52) | two_52) - (0x1p52 + 1023.0);
    V m = of_bits((bits(x) & 0x000fffffffffffff) | one);
    I large = less(all(1.4142135623730951), m);
    m = pick(large, 0.5 * m, m);
    e = pick(large, e + 1.0, e);
    V s = (m - 1.0) / (m + 1.0), z = s * s;
    V result = e * LN2 + (2.0 * s + (2.0 * s * z * series(ATANH + 1, 11, z) + e * LN2_REST));
    return pick(less(all(0.0), x), result, pick(less(x, all(0.0)), all(NAN), all(-INFINITY)));
}

/* sin x and cos x for |x| < 1e5: x = k pi/2 + r, both by their series at r, exchanged and negated by k. */
INLINE void sine_cosine(V x, V *sine, V *cosine) {
    V shifted = x * 0.63661977236758134 + ROUND, k = shifted - ROUND;
    I quarter = bits(shifted);
    V r = ((x - k * QUARTER) - k * QUARTER_2) - k * QUARTER_3, z = r * r;
    V s = r * series(SIN, 9, z), c = series(COS, 10, z);
    I odd = -(quarter & 1), negative_s = (quarter & 2) << 62, negative_c = ((quarter + 1) & 2) << 62;
    *sine = of_bits(bits(pick(odd, c, s)) ^ negative_s);
    *cosine = of_bits(bits(pick(odd, s, c)) ^ negative_c);
}

/* The angle within half a turn of 0. */
INLINE V wrapped(V angle) {
    const double pi = 3.1415926535897932;
    V turns = (angle + pi) / (2 * pi), whole = (turns + ROUND) - ROUND;
    whole = pick(less(turns, whole), whole - 1.0, whole); /* rounded down */
    return (angle + pi) - whole * (2 * pi) - pi;
}
#endif
