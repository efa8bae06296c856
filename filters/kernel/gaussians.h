/* W Gaussians at once: moments of a function, prediction, likelihoods of noise modes, update.

   The mathematics is that of filters/models/sigma_points.py, sensors.py, motion.py and filters/estimators/
   gaussian_bank.py, mode_updates.py, which are the reference; H, Q, R, S, K, P are the matrices of the Kalman filter.
   b points to W particles of a block (layout.h): numbers 0 to n - 1 are the mean, then follows the triangle of P. */
#ifndef USBLDR_GAUSSIANS_H
#define USBLDR_GAUSSIANS_H
#include "lanes.h"
#include "layout.h"

typedef struct {
    V value[2], cov[2][2], cross[MAX_STATES][2]; /* E g(x), cov(g, g), cov(x, g) */
} Moments;

INLINE int at(int n, int i, int j) { return n + (i >= j ? i * (i + 1) / 2 + j : j * (j + 1) / 2 + i); }

INLINE void column(const double *b, int n, int q, V *out) {
    for (int i = 0; i < q; i++) out[i] = AT(b, n + q * (q + 1) / 2 + i);
    for (int i = q; i < n; i++) out[i] = AT(b, n + i * (i + 1) / 2 + q);
}

/* g(a) of the arguments a; those that are no states are 0. */
INLINE void value(const Function *g, const V *a, V *out) {
    V c, s, C = all(1.0), S = all(0.0), along, across;
    double starboard = g->number[1], forward = g->number[2];
    switch (g->kind) {
    case VELOCITY: /* (1 + s) (u' cos d + v' sin d), of axis 0; d + 90 deg of axis 1 */
        along = a[U] - forward * a[R], across = a[V_FORWARD] + starboard * a[R];
        if (g->uses >> CURRENT_EAST & 1) {
            sine_cosine(a[PSI], &s, &c);
            along = along - (a[CURRENT_EAST] * c + a[CURRENT_NORTH] * s);
            across = across - (a[CURRENT_NORTH] * c - a[CURRENT_EAST] * s);
        }
        if (g->uses >> MOUNT & 1) sine_cosine(a[MOUNT], &S, &C);
        out[0] = (1.0 + a[SCALE]) * (g->axis == 0 ? C * along + S * across : C * across - S * along);
        return;
    case COMPASS: /* psi + b0 + b_s sin psi + b_c cos psi */
        out[0] = a[PSI] + a[HEADING_BIAS];
        if (g->uses >> DEVIATION_SIN & 1) {
            sine_cosine(a[PSI], &s, &c);
            out[0] = out[0] + a[DEVIATION_SIN] * s + a[DEVIATION_COS] * c;
        }
        return;
    case FIX: { /* (x, y) + t (V_E, V_N) + lever arm + c, t = offset - tau */
        V t = g->number[0] - a[LATENCY], half = a[PSI] + a[R] * t * 0.5;
        sine_cosine(half, &s, &c);
        if (starboard != 0.0 || forward != 0.0) sine_cosine(a[PSI] + a[R] * t, &S, &C);
        V both[2] = {
            a[X] + (a[U] * c - a[V_FORWARD] * s) * t + (starboard * C - forward * S) + a[BIAS_EAST],
            a[Y] + (a[U] * s + a[V_FORWARD] * c) * t + (starboard * S + forward * C) + a[BIAS_NORTH],
        };
        for (int axis = 0; axis < g->k; axis++) out[axis] = both[g->axis + axis];
        return;
    }
    case DISPLACEMENT: /* eq. (1) times dt */
        sine_cosine(a[PSI], &s, &c);
        out[0] = (a[U] * c - a[V_FORWARD] * s) * g->number[0];
        out[1] = (a[U] * s + a[V_FORWARD] * c) * g->number[0];
        return;
    case TURN: /* psi += r dt */
        out[0] = a[R] * g->number[0];
        return;
    case DECAY: /* c = mean + factor (c - mean) */
        for (int j = 0; j < g->k; j++) out[j] = (g->number[j] - 1.0) * (a[g->argument[j]] - g->number[2 + j]);
        return;
    }
}

/* D[axis][a] = dg/da of the arguments that are states. */
INLINE void derivatives(const Function *g, const V *a, V D[2][ARGUMENTS]) {
    V c, s, C = all(1.0), S = all(0.0);
    double starboard = g->number[1], forward = g->number[2];
    switch (g->kind) {
    case VELOCITY: {
        V gain = 1.0 + a[SCALE], u = a[U] - forward * a[R], v = a[V_FORWARD] + starboard * a[R];
        c = s = all(0.0);
        if (g->uses >> MOUNT & 1) sine_cosine(a[MOUNT], &S, &C);
        V to_u = g->axis == 0 ? C : -S, to_v = g->axis == 0 ? S : C;
        if (g->uses >> CURRENT_EAST & 1) {
            sine_cosine(a[PSI], &s, &c);
            V to_starboard = a[CURRENT_EAST] * c + a[CURRENT_NORTH] * s;
            V ahead = a[CURRENT_NORTH] * c - a[CURRENT_EAST] * s;
            u = u - to_starboard, v = v - ahead;
            D[0][PSI] = gain * (to_v * to_starboard - to_u * ahead);
            D[0][CURRENT_EAST] = gain * (to_v * s - to_u * c);
            D[0][CURRENT_NORTH] = -gain * (to_u * s + to_v * c);
        }
        D[0][U] = gain * to_u, D[0][V_FORWARD] = gain * to_v;
        D[0][R] = gain * (starboard * to_v - forward * to_u);
        D[0][SCALE] = to_u * u + to_v * v, D[0][MOUNT] = gain * (to_u * v - to_v * u);
        return;
    }
    case COMPASS:
        D[0][PSI] = D[0][HEADING_BIAS] = all(1.0);
        if (g->uses >> DEVIATION_SIN & 1) {
            sine_cosine(a[PSI], &s, &c);
            D[0][PSI] = 1.0 + a[DEVIATION_SIN] * c - a[DEVIATION_COS] * s;
            D[0][DEVIATION_SIN] = s, D[0][DEVIATION_COS] = c;
        }
        return;
    case FIX: {
        V t = g->number[0] - a[LATENCY], half = a[PSI] + a[R] * t * 0.5;
        sine_cosine(half, &s, &c);
        if (starboard != 0.0 || forward != 0.0) sine_cosine(a[PSI] + a[R] * t, &S, &C);
        V along[2] = {a[U] * c - a[V_FORWARD] * s, a[U] * s + a[V_FORWARD] * c};       /* V_E, V_N */
        V arm[2] = {starboard * C - forward * S, starboard * S + forward * C};
        for (int j = 0; j < g->k; j++) {
            int axis = g->axis + j;
            V turned_V = (axis == 0 ? -along[1] : along[0]) * t, turned_arm = axis == 0 ? -arm[1] : arm[0];
            D[j][PSI] = turned_V + turned_arm;
            D[j][R] = turned_V * t * 0.5 + turned_arm * t;
            D[j][LATENCY] = -(along[axis] + turned_V * a[R] * 0.5 + turned_arm * a[R]);
            D[j][U] = (axis == 0 ? c : s) * t, D[j][V_FORWARD] = (axis == 0 ? -s : c) * t;
            D[j][X] = D[j][BIAS_EAST] = all(axis == 0), D[j][Y] = D[j][BIAS_NORTH] = all(axis == 1);
        }
        return;
    }
    case DISPLACEMENT: {
        double dt = g->number[0];
        sine_cosine(a[PSI], &s, &c);
        c = c * dt, s = s * dt;
        D[0][PSI] = -a[U] * s - a[V_FORWARD] * c, D[0][U] = c, D[0][V_FORWARD] = -s;
        D[1][PSI] = a[U] * c - a[V_FORWARD] * s, D[1][U] = s, D[1][V_FORWARD] = c;
        return;
    }
    case TURN:
        D[0][R] = all(g->number[0]);
        return;
    case DECAY:
        for (int j = 0; j < g->k; j++)
            for (int q = 0; q < g->k; q++) D[j][g->argument[q]] = all(j == q ? g->number[j] - 1.0 : 0.0);
        return;
    }
}

/* Add J P J' and P J' of some columns, P given by those columns. */
INLINE void add_linear(const Function *g, int n, int first, V P[MAX_COLUMNS][MAX_STATES], V D[2][ARGUMENTS], Moments *out) {
    int k = g->k;
    for (int j = 0; j < k; j++)
        for (int q = first; q < g->columns; q++)
            for (int i = 0; i < n; i++) out->cross[i][j] = out->cross[i][j] + P[q][i] * D[j][g->argument[q]];
    for (int j = 0; j < k; j++)
        for (int l = 0; l <= j; l++) {
            V sum = all(0.0);
            for (int q = first; q < g->columns; q++) sum = sum + out->cross[g->row[q]][l] * D[j][g->argument[q]];
            out->cov[j][l] = out->cov[l][j] = sum;
        }
}

INLINE void clear(Moments *out, int n, int k) {
    for (int j = 0; j < k; j++) {
        for (int i = 0; i < n; i++) out->cross[i][j] = all(0.0);
        for (int l = 0; l < k; l++) out->cov[j][l] = all(0.0);
    }
}

INLINE V difference(const Function *g, V a, V b) { return g->angle ? wrapped(a - b) : a - b; }

/* Mean and covariance of g(x) for x ~ N(m, P), linearised (scale 0) or by sigma points at sqrt(scale) sigma. */
INLINE void moments(const Function *g, int n, double scale, const double *b, Moments *out) {
    int k = g->k, curved = g->nonlinear;
    if (g->kind == SELECTED) {
        for (int j = 0; j < k; j++) {
            V P[MAX_STATES];
            column(b, n, g->row[j], P);
            out->value[j] = AT(b, g->row[j]);
            for (int i = 0; i < n; i++) out->cross[i][j] = P[i];
            for (int l = 0; l < k; l++) out->cov[j][l] = P[g->row[l]];
        }
        return;
    }
    V a[ARGUMENTS], P[MAX_COLUMNS][MAX_STATES], D[2][ARGUMENTS];
    for (int q = 0; q < ARGUMENTS; q++) a[q] = all(0.0);
    for (int q = 0; q < g->columns; q++) {
        a[g->argument[q]] = AT(b, g->row[q]);
        column(b, n, g->row[q], P[q]);
    }
    value(g, a, out->value);
    derivatives(g, a, D);
    clear(out, n, k);
    I far = {0}; /* points more than a quarter turn from the mean: linearised, see sigma_points.py */
    if (curved && scale > 0.0 && g->row[0] == PSI) {
        far = less(all(2.4674011002723395), scale * AT(b, n)); /* (pi / 2)^2 */
    }
    if (!curved || scale == 0.0) {
        add_linear(g, n, 0, P, D, out);
        return;
    }
    Moments linear;
    clear(&linear, n, k);
    if (any(far)) add_linear(g, n, 0, P, D, &linear);
    for (int p = 0; p < curved; p++) { /* Cholesky columns of the nonlinear states; the rest of P */
        V pivot = P[p][g->row[p]], inverse = pick(less(all(0.0), pivot), 1.0 / root(pivot), all(0.0));
        for (int i = 0; i < n; i++) P[p][i] = P[p][i] * inverse;
        for (int q = p + 1; q < g->columns; q++)
            for (int i = 0; i < n; i++) P[q][i] = P[q][i] - P[p][i] * P[p][g->row[q]];
    }
    add_linear(g, n, curved, P, D, out);
    double distance = sqrt(scale), half = 1.0 / (2.0 * scale);
    V shift[2] = {all(0.0), all(0.0)};
    for (int p = 0; p < curved; p++) {
        V there[ARGUMENTS], ahead[2], behind[2];
        for (int q = 0; q < ARGUMENTS; q++) there[q] = a[q];
        for (int q = 0; q < g->columns; q++) there[g->argument[q]] = a[g->argument[q]] + distance * P[p][g->row[q]];
        value(g, there, ahead);
        for (int q = 0; q < g->columns; q++) there[g->argument[q]] = a[g->argument[q]] - distance * P[p][g->row[q]];
        value(g, there, behind);
        for (int j = 0; j < k; j++) {
            ahead[j] = difference(g, ahead[j], out->value[j]), behind[j] = difference(g, behind[j], out->value[j]);
            shift[j] = shift[j] + (ahead[j] + behind[j]);
        }
        for (int j = 0; j < k; j++) {
            V across = (ahead[j] - behind[j]) * (distance * half);
            for (int l = 0; l < k; l++)
                out->cov[j][l] = out->cov[j][l] + (ahead[j] * ahead[l] + behind[j] * behind[l]) * half;
            for (int i = 0; i < n; i++) out->cross[i][j] = out->cross[i][j] + P[p][i] * across;
        }
    }
    for (int j = 0; j < k; j++) {
        shift[j] = shift[j] * half;
        for (int l = 0; l <= j; l++) out->cov[j][l] = out->cov[l][j] = out->cov[j][l] - shift[j] * shift[l];
    }
    if (!any(far)) {
        for (int j = 0; j < k; j++) out->value[j] = out->value[j] + shift[j];
        return;
    }
    for (int j = 0; j < k; j++) {
        out->value[j] = pick(far, out->value[j], out->value[j] + shift[j]);
        for (int l = 0; l < k; l++) out->cov[j][l] = pick(far, linear.cov[j][l], out->cov[j][l]);
        for (int i = 0; i < n; i++) out->cross[i][j] = pick(far, linear.cross[i][j], out->cross[i][j]);
    }
}
#endif
