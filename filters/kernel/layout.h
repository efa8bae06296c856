/* The values that Python and the kernel exchange: estimators/encoding.py packs the same fields in the same order.

   A bank is N Gaussians in n states. In memory, blocks of LANES particles follow each other; a block holds the n means
   and then the lower triangle of the covariance, row by row, LANES numbers for each. The order of every sum over
   particles depends on LANES alone, so all variants of the kernel, whatever their vectors, give the same numbers. */
#ifndef USBLDR_LAYOUT_H
#define USBLDR_LAYOUT_H
#include <stdint.h>

/* What a bank may have at most; Python reads these numbers from the module. MAX_DEPTH: steps that a move changes. */
enum { LANES = 8, MAX_STATES = 24, MAX_MODES = 9, MAX_COLUMNS = 10, MAX_DEPTH = 4, HEADER = 8 };

/* The states that a function may depend on, by name: encoding.py ARGUMENTS. */
enum { PSI, U, V_FORWARD, R, X, Y, SCALE, MOUNT, CURRENT_EAST, CURRENT_NORTH, LATENCY, BIAS_EAST, BIAS_NORTH,
       HEADING_BIAS, DEVIATION_SIN, DEVIATION_COS, ARGUMENTS };

/* g: n states to k values: filters/models/sensors.py and motion.py. */
enum { SELECTED, VELOCITY, COMPASS, FIX, DISPLACEMENT, TURN, DECAY };

typedef struct {
    double number[4];           /* SELECTED: -; VELOCITY: arm; FIX: offset, arm; DISPLACEMENT, TURN: dt; DECAY: -+ */
    int32_t kind, k, nonlinear, columns; /* columns: all of them, of which the first are nonlinear */
    int32_t argument[MAX_COLUMNS], row[MAX_COLUMNS];
    int32_t axis, angle, bilinear, uses; /* uses: bit a is set if argument a is a state */
} Function;

/* A measurement, or one axis of a fix: z = g(x) + v, v in one of the modes with covariance R. */
typedef struct {
    Function g;
    double probability[MAX_MODES], log_probability[MAX_MODES], R[MAX_MODES][3]; /* R: xx, xy, yy */
    double nominal[MAX_MODES];  /* 1 if the mode is of good measurements, else 0 */
    double z[2];
    int32_t modes, fix;         /* fix: of which kind */
} Reading;

enum { NO_FIX, GPS_FIX, USBL_FIX }; /* outliers of USBL come in clusters */

/* From one epoch to the next: motion over dt_s, then the readings. */
typedef struct {
    double dt_s;
    double remaining[2], usual_mps[2], added_m2ps2[2]; /* of the velocity in a gap of the DVL: usual_velocity.py */
    uint64_t state[4];          /* of the generator: state and increment, high word first; if not seeded */
    uint32_t seed[4];           /* words of (seed, epoch) */
    int32_t seeded, gap, readings, padding;
} Step;

/* How the modes of a measurement update a bank: mode_updates.py; DRAWN is of the particle filters, cpf.py. */
enum { MATCHED, COLLAPSED, DRAWN };

typedef struct {
    double scale;               /* squared distance of the sigma points, n + kappa; 0: linearised */
    double resample_below;      /* share of N */
    double walk[MAX_STATES];    /* variance per second of the random walks */
    double bias_s, bias_m2;     /* time constant and variance of the correlated error of the fixes */
    int32_t n, N, update, move_steps, bias_row, padding; /* bias_row: -1 if it is not a state */
} Filter;

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

/* A pass over the fixes for N members of a bank, linear in n states: usbl_likelihood.py of identification. F fixes, M
   members with noise and drift of their own, G linearisations; N is M, or 2 M hypotheses. Arrays as NumPy has them. */
typedef struct {
    double far;                 /* stop before a fix whose chi-square is larger, for any member */
    int32_t n, N, F, M, G, modes, bias_row, per_scalar;
    int32_t first, last;        /* the fixes of this call */
    int32_t axis, padding;      /* 0, 1: update with this axis alone; 2: with both at once; 3: as the noise says, after
                                   the prediction */
} Pass;
typedef struct {
    double *mean, *cov, *log_likelihood;                /* (n, N), (n, n, N), (N): changed, added to */
    const double *residual, *H, *changes;               /* (F, 2, G), (F, 2, n, G), (3, F, M): _Motion.changes */
    const int64_t *group;                               /* (M): linearisation of each */
    const double *probability, *gain, *offset, *R, *counted; /* (modes, M) each; (F, 2, 2); (F): 1 if fix counts */
} PassArrays;
enum { PASS_ARRAYS = 12 };

/* Return the first fix that was not used, or -1 without memory. */
typedef int RunPass(const Pass *, const PassArrays *);
/* Return how many steps were run, or what went wrong. */
typedef int Advance(const Filter *, const Step *, int past, int count, const Reading *, const Guard *, double *state,
                    double *estimates, double *records);
typedef struct {
    Advance *advance;
    RunPass *run_pass;
} Variant;
#endif
