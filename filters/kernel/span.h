/* A filter over a span of steps: predict, then per reading weigh, resample, update; then move (cpf.py, kalman.py).

   Included once for each width W of the vectors; all the rest is the same for every machine. */
#include "random.h"
#include "records.h"
#include "updates.h"

typedef struct {
    const Filter *f;
    int n, N, block, blocks, groups; /* block: numbers of a block of LANES particles */
    int depth, past, resampled;      /* past steps that a move may change, and how many there are */
    double *bank, *start[4], *proposal[4], *spare; /* start: the bank before each past step */
    double *log_weight, *weight, *log_likelihood, *uniform, *past_log[4], *proposed_log[4], *scratch;
    const Step *past_step[4];
    const Reading *past_reading[4];
    Generator random;
    double least; /* effective size within the step */
} Work;

INLINE double *group(const Work *w, double *bank, int g) {
    return bank + (g / (LANES / W)) * w->block + (g % (LANES / W)) * W;
}

static double sum_of(const double *lanes) {
    return ((lanes[0] + lanes[4]) + (lanes[2] + lanes[6])) + ((lanes[1] + lanes[5]) + (lanes[3] + lanes[7]));
}

/* n = 6, without calibration, is most common: a copy of the loops for it is twice as fast. */
#define FOR_EACH_GROUP(w, g, call) \
    do { \
        if ((w)->n == 6) { \
            const int n = 6; \
            for (int g = 0; g < (w)->groups; g++) call; \
        } else { \
            const int n = (w)->n; \
            for (int g = 0; g < (w)->groups; g++) call; \
        } \
    } while (0)

static void predict_bank(Work *w, const Step *step, double *bank) {
    if (step->dt_s == 0.0) return;
    Motion m;
    motion_of(w->f, step, &m);
    FOR_EACH_GROUP(w, g, predict(&m, w->f->scale, n, group(w, bank, g)));
}

/* The scratch memory of a group: innovation, H P H', P H', then the mode probabilities. */
INLINE int scratch_size(int n, int k, int modes) { return k + k * k + k * n + modes; }

INLINE void project_group(Work *w, const Reading *reading, const Noise *noise, int n, double *bank, int g) {
    int k = reading->g.k;
    double *z = w->scratch + (size_t)g * W * scratch_size(n, k, noise->modes);
    Moments p;
    V probability[MAX_MODES];
    project(w->f, reading, n, group(w, bank, g), &p);
    *(InMemory *)(w->log_likelihood + g * W) = likelihoods(&p, noise, k, probability);
    for (int j = 0; j < k; j++) {
        NEXT(z, j) = p.value[j];
        for (int l = 0; l < k; l++) NEXT(z, k + j * k + l) = p.cov[j][l];
        for (int i = 0; i < n; i++) NEXT(z, k + k * k + i * k + j) = p.cross[i][j];
    }
    for (int j = 0; j < noise->modes; j++) NEXT(z, k + k * k + k * n + j) = probability[j];
}

INLINE void update_group(Work *w, const Reading *reading, const Noise *noise, int n, double *bank, int g) {
    int k = reading->g.k;
    double *z = w->scratch + (size_t)g * W * scratch_size(n, k, noise->modes);
    Moments p;
    V probability[MAX_MODES];
    for (int j = 0; j < k; j++) {
        p.value[j] = NEXT(z, j);
        for (int l = 0; l < k; l++) p.cov[j][l] = NEXT(z, k + j * k + l);
        for (int i = 0; i < n; i++) p.cross[i][j] = NEXT(z, k + k * k + i * k + j);
    }
    for (int j = 0; j < noise->modes; j++) probability[j] = NEXT(z, k + k * k + k * n + j);
    update(w->f, reading, noise, n, &p, *(InMemory *)(w->uniform + g * W), probability, group(w, bank, g));
}

static void project_bank(Work *w, const Reading *reading, const Noise *noise, double *bank) {
    FOR_EACH_GROUP(w, g, project_group(w, reading, noise, n, bank, g));
}

static void update_bank(Work *w, const Reading *reading, const Noise *noise, double *bank) {
    if (w->f->update == DRAWN && noise->modes > 1)
        for (int i = 0; i < w->N; i++) w->uniform[i] = uniform(&w->random);
    FOR_EACH_GROUP(w, g, update_group(w, reading, noise, n, bank, g));
}

/* Mean innovation and its covariance over the weighted particles, as a record of the reading. */
static int record(const Work *w, const Reading *reading, int modes, double *out) {
    int k = reading->g.k, size = scratch_size(w->n, k, modes), per_block = LANES / W;
    double e[2] = {0}, P[3] = {0};
    for (int j = 0; j < k; j++) {
        double sum[LANES] = {0};
        for (int g = 0; g < w->groups; g++) {
            InMemory *part = (InMemory *)(sum + g % per_block * W);
            *part = *part + *(InMemory *)(w->weight + g * W) * NEXT(w->scratch + (size_t)g * W * size, j);
        }
        e[j] = sum_of(sum);
    }
    for (int j = 0; j < k; j++)
        for (int l = 0; l <= j; l++) {
            double sum[LANES] = {0};
            for (int g = 0; g < w->groups; g++) {
                InMemory *part = (InMemory *)(sum + g % per_block * W);
                double *z = w->scratch + (size_t)g * W * size;
                V spread = (NEXT(z, j) - e[j]) * (NEXT(z, l) - e[l]);
                *part = *part + *(InMemory *)(w->weight + g * W) * (NEXT(z, k + j * k + l) + spread);
            }
            P[j + l] = sum_of(sum);
        }
    return write_record(reading, e, P, out);
}

static void mean_of(const Work *w, double *mean) {
    double sum[MAX_STATES * LANES] = {0};
    for (int b = 0; b < w->blocks; b++)
        for (int i = 0; i < w->n; i++)
            for (int l = 0; l < LANES; l++)
                sum[i * LANES + l] += w->weight[b * LANES + l] * w->bank[b * w->block + i * LANES + l];
    for (int i = 0; i < w->n; i++) mean[i] = sum_of(sum + i * LANES);
}

/* Mean and covariance of the weighted mixture: eqs. (21) and (22) with weights. */
static void estimate(const Work *w, double *out) {
    int n = w->n, size = w->block;
    double *mean = out, *cov = out + n, sum[(MAX_STATES + MAX_STATES * (MAX_STATES + 1) / 2) * LANES];
    mean_of(w, mean);
    for (int q = 0; q < size; q++) sum[q] = 0.0;
    for (int b = 0; b < w->blocks; b++) {
        const double *m = w->bank + b * size, *p = w->weight + b * LANES;
        for (int i = 0; i < n; i++)
            for (int j = 0; j <= i; j++) {
                double *s = sum + at(n, i, j) * LANES;
                const double *P = m + at(n, i, j) * LANES;
                for (int l = 0; l < LANES; l++)
                    s[l] += p[l] * (P[l] + (m[i * LANES + l] - mean[i]) * (m[j * LANES + l] - mean[j]));
            }
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) cov[i * n + j] = cov[j * n + i] = sum_of(sum + at(n, i, j) * LANES);
    out[n + n * n] = w->least;
}

/* Weights times likelihoods, normalised; return the effective size. */
static double reweigh(Work *w) {
    double top = -INFINITY, sum[LANES] = {0}, squares[LANES] = {0};
    for (int i = 0; i < w->N; i++) {
        w->log_weight[i] += w->log_likelihood[i];
        if (w->log_weight[i] > top) top = w->log_weight[i];
    }
    for (int g = 0; g < w->groups; g++)
        *(InMemory *)(w->weight + g * W) = exponential(*(InMemory *)(w->log_weight + g * W) - top);
    for (int i = w->N; i < w->blocks * LANES; i++) w->weight[i] = 0.0;
    for (int b = 0; b < w->blocks; b++)
        for (int l = 0; l < LANES; l++) sum[l] += w->weight[b * LANES + l];
    double total = sum_of(sum), shift = top + log(total);
    for (int i = 0; i < w->N; i++) w->log_weight[i] -= shift;
    for (int b = 0; b < w->blocks; b++)
        for (int l = 0; l < LANES; l++) {
            double *p = w->weight + b * LANES + l;
            *p /= total;
            squares[l] += *p * *p;
        }
    return 1 / sum_of(squares);
}
