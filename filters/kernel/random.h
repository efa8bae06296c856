/* NumPy's default generator: PCG64 (O'Neill's XSL-RR 128/64), seeded by SeedSequence((seed, epoch)).

   The same numbers as numpy.random.default_rng((seed, epoch)).random(), without 15 microseconds to make it. A counter-based
   generator would be shorter, but the filters in NumPy are the reference: they have to draw the same numbers.
   M. O'Neill, "PCG: a family of simple fast space-efficient statistically good algorithms for random number
   generation", Harvey Mudd College HMC-CS-2014-0905; numpy.org/doc/stable/reference/random/bit_generators. */
#ifndef USBLDR_RANDOM_H
#define USBLDR_RANDOM_H
#include "layout.h"

typedef struct {
    uint64_t high, low;
} Wide; /* 128 bits */

typedef struct {
    Wide state, increment;
    const Step *of; /* the step that seeds it at the first number */
} Generator;

static inline Wide wide_sum(Wide a, Wide b) {
    Wide r = {a.high + b.high, a.low + b.low};
    r.high += r.low < a.low;
    return r;
}

static inline Wide wide_product(Wide a, Wide b) { /* modulo 2^128 */
#ifdef __SIZEOF_INT128__
    unsigned __int128 low = (unsigned __int128)a.low * b.low;
    Wide r = {(uint64_t)(low >> 64) + a.high * b.low + a.low * b.high, (uint64_t)low};
    return r;
#else /* by halves of 32 bits */
    uint64_t a0 = a.low & 0xffffffff, a1 = a.low >> 32, b0 = b.low & 0xffffffff, b1 = b.low >> 32;
    uint64_t middle = (a0 * b0 >> 32) + (a1 * b0 & 0xffffffff) + a0 * b1; /* no carry is lost: below 2^64 */
    Wide r = {a1 * b1 + (a1 * b0 >> 32) + (middle >> 32) + a.high * b.low + a.low * b.high, a.low * b.low};
    return r;
#endif
}

static inline void random_step(Generator *g) {
    const Wide multiplier = {2549297995355413924u, 4865540595714422341u};
    g->state = wide_sum(wide_product(g->state, multiplier), g->increment);
}

static inline uint32_t seed_hash(uint32_t value, uint32_t *constant, uint32_t multiplier) {
    value ^= *constant;
    *constant *= multiplier;
    value *= *constant;
    return value ^ value >> 16;
}

static inline void random_seed(Generator *g) {
    if (!g->of->seeded) { /* the state of a generator that Python made */
        const uint64_t *s = g->of->state;
        g->state = (Wide){s[0], s[1]}, g->increment = (Wide){s[2], s[3]};
        return;
    }
    uint32_t pool[4], constant = 0x43b0d7e5, words[8];
    uint64_t made[4];
    for (int i = 0; i < 4; i++) pool[i] = seed_hash(g->of->seed[i], &constant, 0x931e8875);
    for (int from = 0; from < 4; from++)
        for (int to = 0; to < 4; to++)
            if (from != to) {
                uint32_t mixed = 0xca01f9dd * pool[to] - 0x4973f715 * seed_hash(pool[from], &constant, 0x931e8875);
                pool[to] = mixed ^ mixed >> 16;
            }
    constant = 0x8b51f9dd;
    for (int i = 0; i < 8; i++) words[i] = seed_hash(pool[i % 4], &constant, 0x58f38ded);
    for (int i = 0; i < 4; i++) made[i] = (uint64_t)words[2 * i + 1] << 32 | words[2 * i];
    g->increment = (Wide){made[2] << 1 | made[3] >> 63, made[3] << 1 | 1};
    g->state = (Wide){0, 0};
    random_step(g);
    g->state = wide_sum(g->state, (Wide){made[0], made[1]});
    random_step(g);
}

static inline double uniform(Generator *g) { /* from 0 to 1, 53 bits */
    if (g->of) {
        random_seed(g);
        g->of = 0;
    }
    random_step(g);
    uint64_t mixed = g->state.high ^ g->state.low;
    unsigned turn = (unsigned)(g->state.high >> 58);
    mixed = mixed >> turn | mixed << ((64 - turn) & 63);
    return (double)(mixed >> 11) * 0x1p-53;
}
#endif
