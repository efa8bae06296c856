/* The pass of identification over the fixes: usbl_likelihood.py, and clusters.py for the fixes of a cluster. */
#include <stdlib.h>
#include "updates.h"

/* Some of the N members. */
typedef struct {
    const Pass *p;
    const PassArrays *a;
    int lane; /* the first of them */
} Members;

INLINE int member_of(const Members *w, int l) { /* of a lane; copies of the last member fill the last block */
    int member = w->lane + l;
    return member < w->p->N ? member : w->p->N - 1;
}

/* The numbers of row (N) of a table for the members of a group; with ``group`` by their linearisation. */
INLINE V gathered(const Members *w, const double *row, const int64_t *group) {
    double found[W];
    if (group && w->p->G == 1) return all(row[0]);
    if (!group && w->lane + W <= w->p->N) return *(InMemory *)(row + w->lane);
    for (int l = 0; l < W; l++) found[l] = row[group ? group[member_of(w, l)] : member_of(w, l)];
    return *(InMemory *)found;
}

/* The correlated error decays, dead reckoning drifts. */
INLINE void drift(const Members *w, int f, int n, double *b) {
    const Pass *p = w->p;
    V change[3];
    for (int c = 0; c < 3; c++) change[c] = gathered(w, w->a->changes + (size_t)(c * p->F + f) * p->N, 0);
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
        V gain = gathered(w, w->a->gain + j * w->p->N, 0), offset = gathered(w, w->a->offset + j * w->p->N, 0);
        out->probability[j] = gathered(w, w->a->probability + j * w->p->N, 0);
        out->R[j][0] = gain * R[3 * axis] + offset;
        out->R[j][1] = gain * (k == 2 ? R[1] : 0.0), out->R[j][2] = gain * R[3] + offset;
    }
}

/* Update with the axes from ``axis`` on; ``known`` is their projection, 0 if it is still to be computed. */
INLINE V collapse_axes(const Members *w, int f, int axis, int k, int n, const Moments *known, double *b) {
    Moments computed;
    Noise noise;
    Gain gain;
    V probability[MAX_MODES];
    if (!known) linear_projection(w, f, axis, k, n, b, &computed);
    const Moments *e = known ? known : &computed;
    member_noise(w, f, axis, k, &noise);
    V log_likelihood = likelihoods(e, &noise, k, probability);
    collapsed_gain(e, &noise, k, probability, &gain);
    move_mean(e, n, k, 0, &gain, b);
    reduce_cov(e, n, k, 0, &gain, b);
    return log_likelihood;
}

/* Chi-square of a fix with this projection under its nominal noise. */
INLINE V chi_square(const Members *w, int f, const Moments *e) {
    Noise noise;
    Gain gain;
    member_noise(w, f, 0, 2, &noise);
    kalman_gain(e, 2, noise.R[0][0], noise.R[0][1], noise.R[0][2], &gain);
    return gain.g[0] * e->value[0] + gain.g[1] * e->value[1];
}

/* The weights of two Gaussians in one, and their sum. */
INLINE V shares(V of_a, V of_b, V *p, V *q) {
    V sum = of_a + of_b;
    sum = pick(less(sum, all(2.2250738585072014e-308)), all(2.2250738585072014e-308), sum);
    *p = of_a / sum, *q = of_b / sum;
    return sum;
}

/* A cluster may begin or end: clusters.mixed. ``shifted`` is the hypothesis of an offset. */
INLINE void mix(const Members *w, int f, int n, double *right, double *shifted, V *log_right, V *log_shifted) {
    double begins = w->a->switching[2 * f], ends = w->a->switching[2 * f + 1];
    V weight = exponential(*log_right), of_shifted = exponential(*log_shifted), p, q, kept, stays;
    V ended[MAX_STATES], begun[MAX_STATES];
    *log_right = logarithm(shares(weight * (1.0 - begins), of_shifted * ends, &p, &q));
    *log_shifted = logarithm(shares(weight * begins, of_shifted * (1.0 - ends), &kept, &stays));
    for (int i = 0; i < n; i++) {
        V r = AT(right, i), o = AT(shifted, i), without = i < n - 2 ? o : all(0.0);
        ended[i] = r - without, begun[i] = r - o;
        AT(right, i) = p * r + q * without;
        AT(shifted, i) = kept * r + stays * o;
    }
    V apart = p * q, apart_shifted = kept * stays;
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            V r = AT(right, at(n, i, j)), o = AT(shifted, at(n, i, j)), without = i < n - 2 ? o : all(0.0);
            V with = i == j && i >= n - 2 ? r + w->p->offset_m2 : r;
            AT(right, at(n, i, j)) = p * r + q * without + apart * ended[i] * ended[j];
            AT(shifted, at(n, i, j)) = kept * with + stays * o + apart_shifted * begun[i] * begun[j];
        }
}

/* Each member as the Gaussian of its two hypotheses: clusters.members. */
INLINE void join(int n, double *right, const double *shifted, V log_right, V log_shifted) {
    V p, q, e[MAX_STATES];
    shares(exponential(log_right), exponential(log_shifted), &p, &q);
    for (int i = 0; i < n; i++) {
        e[i] = AT(right, i) - AT(shifted, i);
        AT(right, i) = p * AT(right, i) + q * AT(shifted, i);
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            int k = at(n, i, j);
            AT(right, k) = p * AT(right, k) + q * AT(shifted, k) + p * q * e[i] * e[j];
        }
}

INLINE V log_sum(V a, V b) { /* of exponentials */
    I more = less(a, b);
    V top = pick(more, b, a), rest = pick(more, a, b);
    return top + logarithm(1.0 + exponential(rest - top));
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

INLINE InMemory *of_lanes(double *numbers, int lane) { return (InMemory *)(numbers + lane); }

static int run_pass(const Pass *p, const PassArrays *a) {
    int n = p->n, block = (n + n * (n + 1) / 2) * LANES, blocks = (p->N + LANES - 1) / LANES, doubled = 0;
    size_t size = (size_t)blocks * (size_t)block, weights = (size_t)blocks * LANES;
    size_t projections = weights / W * sizeof(Moments) / 8;
    double *memory = calloc(2 * (size + weights) + projections + 8, 8);
    if (!memory) return NO_MEMORY;
    double *right = (double *)(((uintptr_t)memory + 63) / 64 * 64), *shifted = right + size;
    double *log_right = shifted + size, *log_shifted = log_right + weights;
    Moments *projected = (Moments *)(log_shifted + weights); /* of both axes, of W members each */
    exchange_bank(p, a, block, right, 0);
    for (int f = 0; f < p->F; f++) {
        int joint = !p->per_scalar || a->R[4 * f + 1] != 0.0, k = joint ? 2 : 1, far = 0, offsets = 0;
        for (int lane = 0; lane < p->N; lane += W) {
            Members w = {p, a, lane};
            int from = lane / LANES * block + lane % LANES;
            drift(&w, f, n, right + from);
            if (doubled) {
                drift(&w, f, n, shifted + from);
                continue;
            }
            linear_projection(&w, f, 0, 2, n, right + from, projected + lane / W);
            far = far || any(less(all(p->far), chi_square(&w, f, projected + lane / W)));
        }
        if (far) {
            doubled = 1;
            memcpy(shifted, right, 8 * size);
            for (size_t l = 0; l < weights; l++) log_right[l] = 0.0, log_shifted[l] = -INFINITY;
        }
        for (int lane = 0; lane < p->N; lane += W) {
            Members w = {p, a, lane};
            double *b = right + lane / LANES * block + lane % LANES, *o = shifted + (b - right);
            V total = all(0.0), without = *of_lanes(log_right, lane), with = *of_lanes(log_shifted, lane);
            if (doubled) mix(&w, f, n, b, o, &without, &with);
            for (int axis = 0; axis < (joint ? 1 : 2); axis++) {
                V log_l = collapse_axes(&w, f, axis, k, n, doubled || axis ? 0 : projected + lane / W, b);
                if (doubled) {
                    without = without + log_l, with = with + collapse_axes(&w, f, axis, k, n, 0, o);
                    log_l = log_sum(without, with);
                    without = without - log_l, with = with - log_l;
                }
                total = total + log_l;
            }
            *of_lanes(log_right, lane) = without, *of_lanes(log_shifted, lane) = with;
            offsets = offsets || (doubled && any(less(all(p->log_negligible), with)));
            double *log_l = (double *)&total;
            for (int l = 0; l < W && lane + l < p->N; l++) a->log_likelihood[lane + l] += a->counted[f] * log_l[l];
        }
        if (!doubled || (offsets && f + 1 < p->F)) continue;
        for (int lane = 0; lane < p->N; lane += W) {
            int from = lane / LANES * block + lane % LANES;
            join(n, right + from, shifted + from, *of_lanes(log_right, lane), *of_lanes(log_shifted, lane));
        }
        doubled = 0;
    }
    exchange_bank(p, a, block, right, 1);
    free(memory);
    return GOOD;
}
