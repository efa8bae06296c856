/* The likeliest histories of false fixes in a row: identification/histories.py, which is the reference. */
#ifndef USBLDR_HISTORIES_H
#define USBLDR_HISTORIES_H
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "layout.h"

enum { CORRECT, BEGINS, CONTINUES, DECISIONS };
enum { CANDIDATES = DECISIONS * MAX_HISTORIES, CELL_BITS = 12 };

static const double LOG_2_PI = 0x1.d67f1c864beb4p+0;

/* Of a history: what the next fix depends on, beside mean and covariance. */
typedef struct {
    double log_weight;
    int in_run, gradual, kind, recent, first, octave;
} Past;

/* A history with a fix that it takes for one of the DECISIONS. */
typedef struct {
    Past past;
    double value[2], cov[3], cross[2][MAX_STATES];  /* innovation, its covariance without noise, that with the states */
    double share[MAX_MODES], inverse[MAX_MODES][3], of_fix; /* of each mode in the likelihood; its log */
    double added_m2; /* to the variances of the position (CORRECT) or the offset (BEGINS) */
    int parent, decision, order;
    uint64_t code; /* those of one code agree */
} Candidate;

/* Rows of a covariance have MAX_STATES numbers, of which those beyond n are 0: whole vectors. */
static double *row_of(double *cov, int i) { return cov + (size_t)i * MAX_STATES; }

static int octave_of(uint32_t number) { /* 1 + log2, rounded down; 0 of 0 */
    int bits = 0;
    while (number >> bits) bits++;
    return bits;
}

static void predict_history(const Search *s, const double *change, const Past *past, double *mean, double *cov) {
    int n = s->n, offset = n - 4, rate = n - 2;
    double dt_s = change[0], fade = change[1];
    for (int j = s->bias_row; j < s->bias_row + 2; j++) {
        mean[j] *= fade;
        for (int i = 0; i < n; i++) row_of(cov, j)[i] *= fade;
        for (int i = 0; i < n; i++) row_of(cov, i)[j] *= fade;
    }
    for (int i = 0; i < 2; i++) {
        row_of(cov, i)[i] += change[2];
        row_of(cov, s->bias_row + i)[s->bias_row + i] += (1 - fade * fade) * s->bias_m2;
    }
    if (!past->in_run) return;
    for (int a = 0; a < 2; a++) {
        mean[offset + a] += dt_s * mean[rate + a];
        for (int i = 0; i < n; i++) row_of(cov, offset + a)[i] += dt_s * row_of(cov, rate + a)[i];
    }
    for (int a = 0; a < 2; a++) {
        for (int i = 0; i < n; i++) row_of(cov, i)[offset + a] += dt_s * row_of(cov, i)[rate + a];
        row_of(cov, offset + a)[offset + a] += s->walk_m2 * dt_s;
    }
}

/* The inverse of S + R, xx, xy, yy; return the determinant. */
static double inverted(const double *S, const double *R, double *inverse) {
    double a = S[0] + R[0], b = S[1] + R[1], c = S[2] + R[3], det = a * c - b * b;
    inverse[0] = c / det, inverse[1] = -b / det, inverse[2] = a / det;
    return det;
}

static double squared_distance(const double *e, const double *inverse) {
    return e[0] * (inverse[0] * e[0] + inverse[1] * e[1]) + e[1] * (inverse[1] * e[0] + inverse[2] * e[1]);
}

static void weigh(const Search *s, const SearchArrays *a, int f, Candidate *c) {
    double chi[MAX_MODES], least = INFINITY, sum = 0.0;
    for (int j = 0; j < s->modes; j++) {
        double det = inverted(c->cov, a->R + 4 * ((size_t)j * s->F + f), c->inverse[j]);
        chi[j] = squared_distance(c->value, c->inverse[j]);
        c->share[j] = a->probability[j] / sqrt(det);
        if (chi[j] < least) least = chi[j];
    }
    for (int j = 0; j < s->modes; j++) sum += c->share[j] *= exp(-0.5 * (chi[j] - least));
    for (int j = 0; j < s->modes; j++) c->share[j] /= sum;
    c->of_fix = log(sum) - 0.5 * least - LOG_2_PI;
}

/* What a history may take fix f for: DECISIONS candidates. */
static void branch(const Search *s, const SearchArrays *a, int f, int parent, const Past *past, const double *mean,
                   double *cov, Candidate *of) {
    int n = s->n, offset = n - 4;
    const double *H = a->H + (size_t)f * 2 * n, *kind = a->kinds + 3 * past->kind;
    double e[2], S[3] = {0}, shared[2][2] = {{0}}, inverse[3], dt_s = a->changes[3 * f], cross[2][MAX_STATES] = {{0}};
    for (int k = 0; k < 2; k++) {
        e[k] = a->residual[2 * f + k];
        for (int i = 0; i < offset; i++) e[k] -= H[k * n + i] * mean[i]; /* H of a run's states is 0 */
        for (int i = 0; i < offset; i++)
            for (int j = 0; j < MAX_STATES; j++) cross[k][j] += row_of(cov, i)[j] * H[k * n + i];
    }
    for (int i = 0; i < offset; i++) {
        S[0] += H[i] * cross[0][i], S[1] += H[i] * cross[1][i], S[2] += H[n + i] * cross[1][i];
        for (int k = 0; k < 2 && past->in_run; k++)
            for (int l = 0; l < 2; l++) shared[k][l] += H[k * n + i] * row_of(cov, i)[offset + l];
    }
    inverted(S, a->R + 4 * (size_t)f, inverse);
    int near = squared_distance(e, inverse) < s->far, recent = s->recent_bits, all = (1 << recent) - 1;
    int starts = past->first == f;
    double usual_m2 = kind[2] * kind[2], begun_m2 = fmax(usual_m2, (e[0] * e[0] + e[1] * e[1]) / 2);
    double apart_m2 = starts && f > 0 ? begun_m2 - usual_m2 : 0.0;
    double begins = f ? -expm1(-dt_s / kind[1]) : kind[0] / (kind[0] + kind[1]);
    double ends = past->in_run ? -expm1(-dt_s / kind[0]) : 1.0;
    double prior[DECISIONS] = {log((1 - begins) * ends), log(begins * ends), log(1 - ends)};
    if (near && past->first < f && !s->gradual) prior[BEGINS] = -INFINITY;
    for (int d = 0; d < DECISIONS; d++) {
        Candidate *c = of + d;
        double added = d == CORRECT ? apart_m2 : d == BEGINS ? begun_m2 : 0.0;
        int in_run = d != CORRECT;
        c->past.log_weight = prior[d];
        if (!isfinite(prior[d])) continue; /* it is impossible */
        memcpy(c->cross, cross, sizeof cross);
        c->value[0] = e[0], c->value[1] = e[1];
        c->cov[0] = S[0] + added, c->cov[1] = S[1], c->cov[2] = S[2] + added;
        if (d != CONTINUES)
            for (int i = offset; i < n; i++) c->cross[0][i] = c->cross[1][i] = 0.0;
        for (int k = 0; k < 2; k++) {
            if (d == CORRECT) c->cross[k][k] += apart_m2;
            if (d == BEGINS) c->cross[k][offset + k] = begun_m2;
            if (d != CONTINUES) continue;
            c->value[k] -= mean[offset + k];
            for (int i = 0; i < n; i++) c->cross[k][i] += row_of(cov, i)[offset + k];
        }
        if (d == CONTINUES) {
            const double *x = row_of(cov, offset) + offset, *y = row_of(cov, offset + 1) + offset;
            c->cov[0] += 2 * shared[0][0] + x[0], c->cov[1] += shared[0][1] + shared[1][0] + x[1];
            c->cov[2] += 2 * shared[1][1] + y[1];
        }
        weigh(s, a, f, c);
        c->added_m2 = added;
        c->parent = parent, c->decision = d, c->past = *past;
        c->past.log_weight += c->of_fix + prior[d];
        /* a tail as heavy as a scale that is not known */
        if (d == CORRECT) c->past.log_weight += 0.5 * log(usual_m2 / (usual_m2 + added));
        if (d == BEGINS) c->past.log_weight += 0.5 * log(usual_m2 / added);
        c->past.in_run = in_run;
        c->past.gradual = d != CORRECT && (past->gradual || (d == BEGINS && near));
        c->past.recent = ((past->recent << 1) | in_run) & all;
        if (d == BEGINS) c->past.octave = octave_of((uint32_t)f + 1);
        if (d == CORRECT && past->in_run && past->recent != all) c->past.octave = 0;
        c->past.first = past->first + (in_run && starts);
        int of_long = c->past.recent == all || !in_run ? c->past.octave : 0;
        c->code = (((uint64_t)past->kind << recent | (uint64_t)c->past.recent) << 6) | (uint64_t)of_long;
        for (int k = 0; k < 2; k++)
            c->code = c->code << CELL_BITS | ((uint64_t)(int64_t)floor(mean[k] / s->cell_m) & ((1 << CELL_BITS) - 1));
    }
}

static int by_code(const void *x, const void *y) { /* the likeliest of each first */
    const Candidate *a = *(Candidate *const *)x, *b = *(Candidate *const *)y;
    if (a->code != b->code) return a->code < b->code ? -1 : 1;
    if (a->past.log_weight != b->past.log_weight) return a->past.log_weight > b->past.log_weight ? -1 : 1;
    return a->order - b->order;
}

static int by_weight(const void *x, const void *y) {
    const Candidate *a = *(Candidate *const *)x, *b = *(Candidate *const *)y;
    if (a->past.log_weight != b->past.log_weight) return a->past.log_weight > b->past.log_weight ? -1 : 1;
    return a->order - b->order;
}

static int by_order(const void *x, const void *y) {
    return (*(Candidate *const *)x)->order - (*(Candidate *const *)y)->order;
}

/* Keep the likeliest of those that agree, with the weight of all, and of these the ones of _chosen; return how many. */
static int choose(const Search *s, Candidate **list, int count) {
    int groups = 0, kept = 0, all = (1 << s->recent_bits) - 1, of_kind[MAX_KINDS][2] = {{0}};
    unsigned char longest[MAX_KINDS][33] = {{0}}, started[33] = {0}, ended[33] = {0};
    qsort(list, (size_t)count, sizeof *list, by_code);
    for (int i = 0, end; i < count; i = end) {
        double top = list[i]->past.log_weight, sum = 0.0;
        for (end = i; end < count && list[end]->code == list[i]->code; end++)
            sum += exp(list[end]->past.log_weight - top);
        list[groups] = list[i];
        list[groups]->past.log_weight = top + log(sum);
        list[groups]->order = groups, groups++;
    }
    qsort(list, (size_t)groups, sizeof *list, by_weight);
    for (int i = 0; i < groups; i++) {
        const Past *p = &list[i]->past;
        int is_long = p->recent == all, wanted = is_long && !longest[p->kind][p->octave];
        int octave = p->in_run ? 0 : p->octave, start = p->in_run ? 0 : octave_of((uint32_t)p->first);
        if (wanted) longest[p->kind][p->octave] = 1;
        else wanted = of_kind[p->kind][is_long]++ < s->histories;
        if (start && !started[start]) wanted = started[start] = 1;
        if (octave && !ended[octave]) wanted = ended[octave] = 1;
        if (wanted) list[kept++] = list[i];
    }
    qsort(list, (size_t)kept, sizeof *list, by_order);
    return kept;
}

/* Mean and covariance of the parent, corrected by the fix: the moments of the modes' mixture. */
static void correct(const Search *s, const Candidate *c, double *mean, double *cov) {
    int n = s->n, offset = n - 4, rate = n - 2, first = c->decision == CORRECT ? 0 : offset;
    double g[2] = {0}, G[3] = {0};
    if (c->decision != CONTINUES) {
        for (int i = offset; i < n; i++)
            for (int j = mean[i] = 0; j < n; j++) row_of(cov, i)[j] = row_of(cov, j)[i] = 0.0;
        for (int k = 0; k < 2; k++) {
            row_of(cov, first + k)[first + k] += c->added_m2;
            if (c->decision == BEGINS) row_of(cov, rate + k)[rate + k] = s->rate_m2;
        }
    }
    for (int j = 0; j < s->modes; j++) {
        const double *M = c->inverse[j], *e = c->value;
        double p = c->share[j], w[2] = {M[0] * e[0] + M[1] * e[1], M[1] * e[0] + M[2] * e[1]};
        for (int k = 0; k < 2; k++) g[k] += p * w[k];
        G[0] += p * (w[0] * w[0] - M[0]), G[1] += p * (w[0] * w[1] - M[1]), G[2] += p * (w[1] * w[1] - M[2]);
    }
    G[0] -= g[0] * g[0], G[1] -= g[0] * g[1], G[2] -= g[1] * g[1];
    for (int i = 0; i < (c->decision == CORRECT ? offset : n); i++) { /* the others are 0 */
        const double *x = c->cross[0], *y = c->cross[1], left[2] = {x[i] * G[0] + y[i] * G[1], x[i] * G[1] + y[i] * G[2]};
        double *row = row_of(cov, i);
        mean[i] += x[i] * g[0] + y[i] * g[1];
        for (int j = 0; j < MAX_STATES; j++) row[j] += left[0] * x[j] + left[1] * y[j];
    }
}

static int run_histories(const Search *s, const SearchArrays *a) {
    int n = s->n, count = s->kinds;
    size_t one = (size_t)(n + 1) * MAX_STATES, bank = MAX_HISTORIES * one;
    double *memory = calloc(2 * bank, sizeof(double)), *now = memory, *then = memory + bank;
    Candidate *candidates = malloc(CANDIDATES * sizeof(Candidate)), *list[CANDIDATES];
    Past past[MAX_HISTORIES] = {{0}};
    int status = memory && candidates ? GOOD : NO_MEMORY;
    for (int h = 0; status == GOOD && h < count; h++) {
        past[h].kind = h;
        memcpy(now + one * (size_t)h, a->mean + (size_t)h * n, sizeof(double) * (size_t)n);
        for (int i = 0; i < n; i++)
            memcpy(row_of(now + one * (size_t)h + MAX_STATES, i), a->cov + (size_t)(h * n + i) * n,
                   sizeof(double) * (size_t)n);
    }
    for (int f = 0; status == GOOD && f < s->F; f++) {
        size_t row = (size_t)f * MAX_HISTORIES;
        int possible = 0;
        for (int h = 0; h < count; h++) {
            double *mean = now + one * (size_t)h, *cov = mean + MAX_STATES;
            predict_history(s, a->changes + 3 * f, past + h, mean, cov);
            branch(s, a, f, h, past + h, mean, cov, candidates + DECISIONS * h);
        }
        for (int d = 0; d < DECISIONS; d++) /* in the order of NumPy */
            for (int h = 0; h < count; h++) {
                Candidate *c = candidates + DECISIONS * h + d;
                c->order = d * count + h;
                if (isfinite(c->past.log_weight)) list[possible++] = c;
            }
        count = choose(s, list, possible);
        for (int h = 0; h < count; h++) {
            double *mean = then + one * (size_t)h;
            memcpy(mean, now + one * (size_t)list[h]->parent, one * sizeof(double));
            correct(s, list[h], mean, mean + MAX_STATES);
            past[h] = list[h]->past;
            a->log_weight[row + h] = past[h].log_weight, a->first[row + h] = past[h].first;
            a->parent[row + h] = list[h]->parent, a->decision[row + h] = list[h]->decision;
            a->gradual[row + h] = past[h].gradual;
        }
        a->count[f] = count;
        double *free_bank = now;
        now = then, then = free_bank;
    }
    free(memory);
    free(candidates);
    return status;
}
#endif
