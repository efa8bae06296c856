/* The pass of identification over the fixes: fix_likelihoods and _Fixes, _Motion of usbl_likelihood.py. */
#include <stdlib.h>
#include "updates.h"

/* N members in blocks, and what differs between the members of one group. */
typedef struct {
    const Pass *p;
    const PassArrays *a;
    int block, lane; /* numbers in a block; the first member of the group */
} Members;

INLINE int member_of(const Members *w, int l) { /* of a lane; copies of the last member fill the last block */
    int member = w->lane + l;
    return (member < w->p->N ? member : w->p->N - 1) % w->p->M;
}

/* The numbers of row (M) of a table for the members of a group; with ``group`` by their linearisation. */
INLINE V gathered(const Members *w, const double *row, const int64_t *group) {
    double found[W];
    for (int l = 0; l < W; l++) found[l] = row[group ? group[member_of(w, l)] : member_of(w, l)];
    return *(InMemory *)found;
}

/* The correlated error decays, dead reckoning drifts. */
INLINE void drift(const Members *w, int f, int n, double *b) {
    const Pass *p = w->p;
    V change[3];
    for (int c = 0; c < 3; c++) change[c] = gathered(w, w->a->changes + (size_t)(c * p->F + f) * p->M, 0);
    for (int j = p->bias_row; j < p->bias_row + 2; j++) {
        AT(b, j) = AT(b, j) * change[0];
        for (int i = 0; i < n; i++) AT(b, at(n, i, j)) = AT(b, at(n, i, j)) * change[0];
        AT(b, at(n, j, j)) = AT(b, at(n, j, j)) * change[0];
    }
    for (int i = 0; i < 2; i++) {
        int j = p->bias_row + i;
        AT(b, at(n, j, j)) = AT(b, at(n, j, j)) + change[1];
        AT(b, at(n, i, i)) = AT(b, at(n, i, i)) + change[2];
    }
}

/* e = z - H m, H P H', P H' of the axes from ``axis`` on. */
INLINE void linear_projection(const Members *w, int f, int axis, int k, int n, const double *b, Moments *out) {
    const Pass *p = w->p;
    V h[2][MAX_STATES], P[MAX_STATES];
    clear(out, n, k);
    for (int j = 0; j < k; j++) {
        size_t row = (size_t)(f * 2 + axis + j) * p->G;
        out->value[j] = gathered(w, w->a->residual + row, w->a->group);
        for (int i = 0; i < n; i++) {
            h[j][i] = gathered(w, w->a->H + row * n + (size_t)i * p->G, w->a->group);
            out->value[j] = out->value[j] - h[j][i] * AT(b, i);
        }
    }
    for (int q = 0; q < n; q++) {
        column(b, n, q, P);
        for (int j = 0; j < k; j++)
            for (int i = 0; i < n; i++) out->cross[i][j] = out->cross[i][j] + P[i] * h[j][q];
    }
    for (int j = 0; j < k; j++)
        for (int l = 0; l < k; l++)
            for (int i = 0; i < n; i++) out->cov[j][l] = out->cov[j][l] + h[j][i] * out->cross[i][l];
}

/* The modes of the axes from ``axis`` on: gain R + offset I, for each member (BankNoise). */
INLINE void member_noise(const Members *w, int f, int axis, int k, Noise *out) {
    const double *R = w->a->R + 4 * f;
    out->modes = w->p->modes;
    for (int j = 0; j < out->modes; j++) {
        V gain = gathered(w, w->a->gain + j * w->p->M, 0), offset = gathered(w, w->a->offset + j * w->p->M, 0);
        out->probability[j] = gathered(w, w->a->probability + j * w->p->M, 0);
        out->R[j][0] = gain * R[3 * axis] + offset;
        out->R[j][1] = gain * (k == 2 ? R[1] : 0.0), out->R[j][2] = gain * R[3] + offset;
    }
}

INLINE V collapse_axes(const Members *w, int f, int axis, int k, int n, double *b) {
    Moments e;
    Noise noise;
    Gain gain;
    V probability[MAX_MODES];
    linear_projection(w, f, axis, k, n, b, &e);
    member_noise(w, f, axis, k, &noise);
    V log_likelihood = likelihoods(&e, &noise, k, probability);
    collapsed_gain(&e, &noise, k, probability, &gain);
    move_mean(&e, n, k, &gain, b);
    reduce_cov(&e, n, k, &gain, b);
    return log_likelihood;
}

/* Chi-square of a fix under its nominal noise. */
INLINE V chi_square(const Members *w, int f, int n, const double *b) {
    Moments e;
    Noise noise;
    Gain gain;
    linear_projection(w, f, 0, 2, n, b, &e);
    member_noise(w, f, 0, 2, &noise);
    kalman_gain(&e, 2, noise.R[0][0], noise.R[0][1], noise.R[0][2], &gain);
    return gain.g[0] * e.value[0] + gain.g[1] * e.value[1];
}

static void exchange_bank(const Pass *p, const PassArrays *a, int block, double *bank, int out) {
    int n = p->n;
    for (int i = 0; i < n; i++)
        for (int l = 0; l < (p->N + LANES - 1) / LANES * LANES; l++) {
            int member = l < p->N ? l : p->N - 1;
            double *b = bank + l / LANES * block + l % LANES, *m = a->mean + i * p->N + member;
            if (out && l < p->N) *m = b[i * LANES];
            if (!out) b[i * LANES] = *m;
            for (int j = 0; j <= i; j++) {
                double *P = a->cov + (size_t)(i * n + j) * p->N + member, *Q = a->cov + (size_t)(j * n + i) * p->N + member;
                if (out && l < p->N) *P = *Q = b[at(n, i, j) * LANES];
                if (!out) b[at(n, i, j) * LANES] = *P;
            }
        }
}

static int run_pass(const Pass *p, const PassArrays *a) {
    int n = p->n, block = (n + n * (n + 1) / 2) * LANES, blocks = (p->N + LANES - 1) / LANES, f, stop = 0;
    size_t size = (size_t)blocks * (size_t)block;
    double *memory = malloc(8 * 2 * size + 64);
    if (!memory) return -1;
    double *bank = (double *)(((uintptr_t)memory + 63) / 64 * 64), *before = bank + size;
    exchange_bank(p, a, block, bank, 0);
    for (f = p->first; f < p->last; f++) {
        int joint = p->axis == 2 || (p->axis == 3 && (!p->per_scalar || a->R[4 * f + 1] != 0.0));
        int from = p->axis < 2 ? p->axis : 0, to = p->axis == 0 || joint ? 1 : 2;
        if (p->axis == 3) {
            memcpy(before, bank, 8 * size);
            for (int lane = 0; lane < p->N; lane += W) {
                Members w = {p, a, block, lane};
                double *b = bank + lane / LANES * block + lane % LANES;
                drift(&w, f, n, b);
                stop = stop || any(less(all(p->far), chi_square(&w, f, n, b)));
            }
        }
        if (stop) break;
        for (int lane = 0; lane < p->N; lane += W) {
            Members w = {p, a, block, lane};
            double *b = bank + lane / LANES * block + lane % LANES;
            V total = all(0.0);
            for (int axis = from; axis < to; axis++) total = total + collapse_axes(&w, f, axis, joint ? 2 : 1, n, b);
            double *log_l = (double *)&total;
            for (int l = 0; l < W && lane + l < p->N; l++) a->log_likelihood[lane + l] += a->counted[f] * log_l[l];
        }
    }
    exchange_bank(p, a, block, stop ? before : bank, 1);
    free(memory);
    return f;
}
