/* The values that Python and the kernel exchange.

   A bank is N Gaussians in n states. In memory, blocks of LANES particles follow each other; a block holds the n means
   and then the lower triangle of the covariance, row by row, LANES numbers for each. The order of every sum over
   particles depends on LANES alone, so all variants of the kernel, whatever their vectors, give the same numbers. */
#ifndef USBLDR_LAYOUT_H
#define USBLDR_LAYOUT_H
#include <stdint.h>

/* What a bank may have at most; Python reads these numbers from the module. MAX_DEPTH: steps that a move changes. */
enum { LANES = 8, MAX_STATES = 24, MAX_MODES = 9, MAX_COLUMNS = 10, MAX_DEPTH = 4 };

/* The states that a function may depend on, by name: encoding.py ARGUMENTS. */
enum { PSI, U, V_FORWARD, R, X, Y, SCALE, MOUNT, CURRENT_EAST, CURRENT_NORTH, LATENCY, BIAS_EAST, BIAS_NORTH,
       HEADING_BIAS, DEVIATION_SIN, DEVIATION_COS, ARGUMENTS };

/* g: n states to k values: filters/models/sensors.py and motion.py. */
enum { SELECTED, VELOCITY, COMPASS, FIX, DISPLACEMENT, TURN, DECAY };

/* Each structure that Python writes is a list of its fields, from which follow the structure and what module.c tells
   Python of it: kernel/__init__.py. */
#define DECLARED(type, name, dimension) type name dimension;

#define FUNCTION_FIELDS(FIELD) \
    FIELD(double, number, [4]) /* SELECTED: -; VELOCITY: arm; FIX: offset, arm; DISPLACEMENT, TURN: dt; DECAY: -+ */ \
    FIELD(int32_t, kind, ) FIELD(int32_t, k, ) \
    FIELD(int32_t, nonlinear, ) FIELD(int32_t, columns, ) /* columns: all of them, the nonlinear ones first */ \
    FIELD(int32_t, argument, [MAX_COLUMNS]) FIELD(int32_t, row, [MAX_COLUMNS]) \
    FIELD(int32_t, axis, ) FIELD(int32_t, angle, ) FIELD(int32_t, bilinear, ) \
    FIELD(int32_t, uses, ) /* bit a is set if argument a is a state */ \
    FIELD(int32_t, held, ) FIELD(int32_t, padding, ) /* held: bits of rows that an update leaves as they are */
typedef struct { FUNCTION_FIELDS(DECLARED) } Function;

/* The modes of a noise. */
typedef double Covariance[3]; /* xx, xy, yy */
#define NOISE_MODES_FIELDS(FIELD) \
    FIELD(double, probability, [MAX_MODES]) FIELD(double, log_probability, [MAX_MODES]) \
    FIELD(Covariance, R, [MAX_MODES]) \
    FIELD(double, nominal, [MAX_MODES]) /* 1 if the mode is of good measurements, else 0 */
typedef struct { NOISE_MODES_FIELDS(DECLARED) } NoiseModes;

/* A measurement, or one axis of a fix: z = g(x) + v, v in one of the modes with covariance R. */
#define READING_FIELDS(FIELD) \
    FIELD(Function, g, ) FIELD(NoiseModes, noise, ) \
    FIELD(double, z, [2]) \
    FIELD(int32_t, modes, ) FIELD(int32_t, fix, ) /* fix: of which kind */
typedef struct { READING_FIELDS(DECLARED) } Reading;

enum { NO_FIX, GPS_FIX, USBL_FIX }; /* outliers of USBL come in clusters */

/* From one epoch to the next: motion over dt_s, then the readings. */
#define STEP_FIELDS(FIELD) \
    FIELD(double, dt_s, ) \
    FIELD(double, remaining, [3]) FIELD(double, usual, [3]) \
    FIELD(double, added, [3]) /* of velocity and turn rate in a gap of the DVL or the compass: usual_motion.py */ \
    FIELD(uint64_t, state, [4]) /* of the generator: state and increment, high word first; if not seeded */ \
    FIELD(uint32_t, seed, [4]) /* words of (seed, epoch) */ \
    FIELD(int32_t, seeded, ) FIELD(int32_t, gap, ) FIELD(int32_t, readings, ) FIELD(int32_t, padding, )
typedef struct { STEP_FIELDS(DECLARED) } Step;

/* How the modes of a measurement update a bank: mode_updates.py; DRAWN is of the particle filters, cpf.py. */
enum { MATCHED, COLLAPSED, DRAWN };

#define FILTER_FIELDS(FIELD) \
    FIELD(double, scale, ) /* squared distance of the sigma points, n + kappa; 0: linearised */ \
    FIELD(double, resample_below, ) /* share of N */ \
    FIELD(double, walk, [MAX_STATES]) /* variance per second of the random walks */ \
    FIELD(double, bias_s, ) FIELD(double, bias_m2, ) /* correlated error of the fixes: time constant, variance */ \
    FIELD(int32_t, n, ) FIELD(int32_t, N, ) FIELD(int32_t, update, ) FIELD(int32_t, move_steps, ) \
    FIELD(int32_t, bias_row, ) FIELD(int32_t, padding, ) /* bias_row: -1 if it is not a state */
typedef struct { FILTER_FIELDS(DECLARED) } Filter;

/* A row of the estimates: mean (n), covariance (n, n), least effective size, share of accepted moves. The first row is
   given: of the epoch before. */
/* A row of the records: */
enum { E = 0, SD = 2, NOMINAL_SD = 4, SCORE = 6, NOMINAL = 8, SHIFT = 9 };

enum { GOOD, SINGULAR = -1, NO_MEMORY = -2 };

/* When a step calls for hypotheses about its fixes (guard.h), so that the kernel stops before it. */
typedef struct {
    const double *log_relocation; /* of each step: log probability of a drift that nothing has shown; NaN: no fix */
    double outlier_m2;            /* variance of an outlier */
} Guard;

/* A pass over all fixes for N members of a bank, linear in n states, and for two hypotheses of each in a cluster:
   usbl_likelihood.py and clusters.py of identification. F fixes, G linearisations. Arrays as NumPy has them. */
#define PASS_FIELDS(FIELD) \
    FIELD(double, far, ) /* chi-square of a fix that may begin a cluster, for any member */ \
    FIELD(double, offset_m2, ) FIELD(double, log_negligible, ) /* variance of an offset; weight of one that ends it */ \
    FIELD(int32_t, n, ) FIELD(int32_t, N, ) FIELD(int32_t, F, ) FIELD(int32_t, G, ) \
    FIELD(int32_t, modes, ) FIELD(int32_t, bias_row, ) FIELD(int32_t, per_scalar, ) FIELD(int32_t, padding, )
typedef struct { PASS_FIELDS(DECLARED) } Pass;

typedef struct {
    double *mean, *cov, *log_likelihood;                /* (n, N), (n, n, N), (N): changed, added to */
    const double *residual, *H, *changes;               /* (F, 2, G), (F, 2, n, G), (3, F, N): _Motion.changes */
    const int64_t *group;                               /* (N): linearisation of each */
    const double *probability, *gain, *offset, *R;      /* (modes, N) each; (F, 2, 2) */
    const double *counted, *switching;                  /* (F): 1 if fix counts; (F, 2): a cluster begins, ends */
} PassArrays;
enum { PASS_ARRAYS = 13 };

/* The search for false fixes in a row: histories.h. The last four of n states are those of a run: offset and rate. */
enum { MAX_HISTORIES = 160, MAX_KINDS = 4 }; /* of MAX_SEARCHED fixes: at most 152 */
#define SEARCH_FIELDS(FIELD) \
    FIELD(double, far, ) FIELD(double, walk_m2, ) FIELD(double, rate_m2, ) FIELD(double, bias_m2, ) \
    FIELD(double, cell_m, ) /* two histories that agree in the recent fixes lie in the same square of this size */ \
    FIELD(int32_t, n, ) FIELD(int32_t, F, ) FIELD(int32_t, modes, ) FIELD(int32_t, kinds, ) \
    FIELD(int32_t, bias_row, ) FIELD(int32_t, histories, ) FIELD(int32_t, recent_bits, ) FIELD(int32_t, gradual, )
typedef struct { SEARCH_FIELDS(DECLARED) } Search;

typedef struct {
    const double *residual, *H, *changes, *probability, *R; /* (F, 2), (F, 2, n), (F, 3), (modes), (modes, F, 2, 2) */
    const double *mean, *cov, *kinds;                       /* (kinds, n), (kinds, n, n), (kinds, 3) */
    double *log_weight;                                     /* (F, MAX_HISTORIES): results after each fix */
    int64_t *first, *parent, *decision, *gradual;           /* as log_weight */
    int64_t *count;                                         /* (F): how many of them there are */
} SearchArrays;
enum { SEARCH_ARRAYS = 14 };

/* Return GOOD or NO_MEMORY. */
typedef int RunPass(const Pass *, const PassArrays *);
typedef int RunHistories(const Search *, const SearchArrays *);
/* Return how many steps were run, or what went wrong. */
typedef int Advance(const Filter *, const Step *, int past, int count, const Reading *, const Guard *, double *state,
                    double *estimates, double *records);
typedef struct {
    Advance *advance;
    RunPass *run_pass;
    RunHistories *run_histories;
} Variant;
#endif
