/* Prediction of W Gaussians, the likelihoods of the noise modes, and the three ways to update with them. */
#ifndef USBLDR_UPDATES_H
#define USBLDR_UPDATES_H
#include "gaussians.h"

#define UNKNOWN_YAW_RAD2 (0.35 * 0.35) /* motion.py */
#define NO_LENGTH_M2 1e-30

/* The variance along the displacement d that an unknown yaw causes, to be multiplied by d d' (motion.py); p is the
   variance of the yaw, G (xx, xy, yy) what the step adds to the covariance. */
INLINE V variance_along(V p, const V *d, const V *G) {
    V length2 = d[0] * d[0] + d[1] * d[1], across = d[1] * d[1] * G[0] - 2.0 * d[0] * d[1] * G[1] + d[0] * d[0] * G[2];
    I applies = less(all(UNKNOWN_YAW_RAD2), p) & less(all(0.0), across);
    length2 = pick(less(all(NO_LENGTH_M2), length2), length2, all(NO_LENGTH_M2));
    return pick(applies, p / (2.0 + p) * across / (length2 * length2), all(0.0));
}

/* x' = x + d: P' = P + cov(x, d) + cov(d, x) + cov(d, d), for the rows that d changes. */
INLINE void increment(const Function *g, int n, double scale, const int *rows, double *b) {
    Moments d;
    int k = g->k;
    moments(g, n, scale, b, &d);
    if (g->kind == DISPLACEMENT) {
        V G[3];
        for (int j = 0; j < 2; j++)
            for (int l = 0; l <= j; l++) G[j + l] = d.cross[rows[j]][l] + d.cross[rows[l]][j] + d.cov[j][l];
        V along = variance_along(AT(b, at(n, PSI, PSI)), d.value, G);
        for (int j = 0; j < 2; j++)
            for (int l = 0; l <= j; l++) d.cov[j][l] = d.cov[j][l] + along * d.value[j] * d.value[l];
    }
    for (int j = 0; j < k; j++) {
        AT(b, rows[j]) = AT(b, rows[j]) + d.value[j];
        for (int i = 0; i < n; i++)
            if (i != rows[0] && i != rows[k - 1]) AT(b, at(n, i, rows[j])) = AT(b, at(n, i, rows[j])) + d.cross[i][j];
        for (int l = 0; l <= j; l++)
            AT(b, at(n, rows[j], rows[l])) =
                AT(b, at(n, rows[j], rows[l])) + (d.cross[rows[j]][l] + d.cross[rows[l]][j] + d.cov[j][l]);
    }
}

/* The motion of a step: half a turn, the displacement, half a turn, the decays (motion.py); then the added variances. */
typedef struct {
    Function part[6];
    int rows[6][2], parts; /* rows: those that the part changes */
    double added[MAX_STATES];
} Motion;

static Function *add_part(Motion *m, int kind, int k, const int *rows, int nonlinear, int columns, const int *arguments,
                          const int *from) {
    Function *g = &m->part[m->parts];
    memset(g, 0, sizeof *g);
    g->kind = kind, g->k = k, g->nonlinear = nonlinear, g->columns = columns;
    for (int q = 0; q < columns; q++) g->argument[q] = arguments[q], g->row[q] = from[q], g->uses |= 1 << arguments[q];
    for (int j = 0; j < k; j++) m->rows[m->parts][j] = rows[j];
    m->parts++;
    return g;
}

static void motion_of(const Filter *f, const Step *step, Motion *m) {
    const int psi[] = {PSI}, rate[] = {R}, path[] = {PSI, U, V_FORWARD}, place[] = {X, Y}, speed[] = {U, V_FORWARD};
    const int bias[] = {BIAS_EAST, BIAS_NORTH}, bias_rows[] = {f->bias_row, f->bias_row + 1};
    double dt = step->dt_s;
    m->parts = 0;
    add_part(m, TURN, 1, psi, 0, 1, rate, rate)->number[0] = dt / 2;
    add_part(m, DISPLACEMENT, 2, place, 1, 3, path, path)->number[0] = dt;
    add_part(m, TURN, 1, psi, 0, 1, rate, rate)->number[0] = dt / 2;
    for (int i = 0; i < f->n; i++) m->added[i] = f->walk[i] * dt;
    if (step->gap) {
        Function *relax = add_part(m, DECAY, 2, speed, 0, 2, speed, speed);
        for (int j = 0; j < 2; j++) relax->number[j] = step->remaining[j], relax->number[2 + j] = step->usual[j];
        relax = add_part(m, DECAY, 1, rate, 0, 1, rate, rate);
        relax->number[0] = step->remaining[2], relax->number[2] = step->usual[2];
        for (int j = 0; j < 3; j++) m->added[j < 2 ? speed[j] : R] = step->added[j];
    }
    if (f->bias_row >= 0) {
        Function *decay = add_part(m, DECAY, 2, bias_rows, 0, 2, bias, bias_rows);
        for (int j = 0; j < 2; j++) {
            decay->number[j] = exp(-dt / f->bias_s);
            m->added[bias_rows[j]] = -expm1(-2 * dt / f->bias_s) * f->bias_m2;
        }
    }
}

/* m- = f(m), P- = F P F' + Q. */
INLINE void predict(const Motion *m, double scale, int n, double *b) {
    for (int p = 0; p < m->parts; p++) increment(&m->part[p], n, scale, m->rows[p], b);
    for (int i = 0; i < n; i++) AT(b, at(n, i, i)) = AT(b, at(n, i, i)) + m->added[i];
}

/* Innovation and its moments: e = z - E g(x), H P H', P H'. */
INLINE void project(const Filter *f, const Reading *reading, int n, const double *b, Moments *out) {
    moments(&reading->g, n, f->scale, b, out);
    for (int j = 0; j < reading->g.k; j++) out->value[j] = difference(&reading->g, all(reading->z[j]), out->value[j]);
}

/* Inverse (xx, xy, yy) of S = H P H' + R; return 1 / |S|. */
INLINE V inverse_of(const Moments *p, int k, V xx, V xy, V yy, V inverse[3]) {
    V a = p->cov[0][0] + xx;
    if (k == 1) return inverse[0] = 1.0 / a;
    V c = p->cov[0][1] + xy, d = p->cov[1][1] + yy, one_over_det = 1.0 / (a * d - c * c);
    inverse[0] = d * one_over_det, inverse[1] = -c * one_over_det, inverse[2] = a * one_over_det;
    return one_over_det;
}

INLINE void scaled_by(const V inverse[3], const V *e, int k, V *out) { /* S^-1 e */
    if (k == 1) {
        out[0] = inverse[0] * e[0];
        return;
    }
    out[0] = inverse[0] * e[0] + inverse[1] * e[1], out[1] = inverse[1] * e[0] + inverse[2] * e[1];
}

/* The modes of a noise, for each particle. */
typedef struct {
    int modes;
    V probability[MAX_MODES], R[MAX_MODES][3]; /* R: xx, xy, yy */
} Noise;

/* The noise that an update uses: all modes of the reading, or one with the covariance of the mixture. */
static void noise_of(const Reading *reading, int matched, Noise *out) {
    out->modes = matched ? 1 : reading->modes;
    for (int j = 0; j < out->modes; j++) {
        out->probability[j] = all(matched ? 1.0 : reading->noise.probability[j]);
        for (int i = 0; i < 3; i++) {
            double mixture = 0.0;
            for (int q = 0; q < reading->modes; q++) mixture += reading->noise.probability[q] * reading->noise.R[q][i];
            out->R[j][i] = all(matched ? mixture : reading->noise.R[j][i]);
        }
    }
}

/* Posterior probabilities p_j of the modes, and the predictive log likelihood: log sum eps_j N(e; 0, S_j).

   With d_j = e' S_j^-1 e and the least of them d: log sum eps_j |S_j|^-1/2 exp((d - d_j) / 2) - d / 2 - k / 2 log 2 pi. */
INLINE V likelihoods(const Moments *p, const Noise *noise, int k, V *probability) {
    V distance[MAX_MODES], least = all(INFINITY), sum = all(0.0);
    for (int j = 0; j < noise->modes; j++) {
        V inverse[3], scaled[2];
        V one_over_det = inverse_of(p, k, noise->R[j][0], noise->R[j][1], noise->R[j][2], inverse);
        scaled_by(inverse, p->value, k, scaled);
        distance[j] = scaled[0] * p->value[0];
        if (k == 2) distance[j] = distance[j] + scaled[1] * p->value[1];
        probability[j] = noise->probability[j] * root(one_over_det);
        least = pick(less(distance[j], least), distance[j], least);
    }
    for (int j = 0; j < noise->modes; j++) {
        if (noise->modes > 1) probability[j] = probability[j] * exponential(0.5 * (least - distance[j]));
        sum = sum + probability[j];
    }
    V one_over_sum = 1.0 / sum;
    for (int j = 0; j < noise->modes; j++) probability[j] = probability[j] * one_over_sum;
    return logarithm(sum) - 0.5 * (least + k * 1.8378770664093453);
}

/* g, the score of the predictive likelihood, and G, its negative curvature: see apply_gain in gaussian_bank.py. */
typedef struct {
    V g[2], G[3];
} Gain;

/* The gain of one R for each particle: S^-1 e and S^-1. */
INLINE void kalman_gain(const Moments *p, int k, V xx, V xy, V yy, Gain *out) {
    out->g[1] = out->G[1] = out->G[2] = all(0.0);
    inverse_of(p, k, xx, xy, yy, out->G);
    scaled_by(out->G, p->value, k, out->g);
}

/* The gain of the whole mixture: sum p_j S_j^-1 e, sum p_j (S_j^-1 - S_j^-1 e e' S_j^-1) + g g' (Masreliez). */
INLINE void collapsed_gain(const Moments *p, const Noise *noise, int k, const V *probability, Gain *out) {
    for (int i = 0; i < 3; i++) out->G[i] = all(0.0);
    out->g[0] = out->g[1] = all(0.0);
    for (int j = 0; j < noise->modes; j++) {
        Gain one;
        kalman_gain(p, k, noise->R[j][0], noise->R[j][1], noise->R[j][2], &one);
        V w = probability[j];
        for (int i = 0; i < k; i++) out->g[i] = out->g[i] + w * one.g[i];
        out->G[0] = out->G[0] + w * (one.G[0] - one.g[0] * one.g[0]);
        if (k == 1) continue;
        out->G[1] = out->G[1] + w * (one.G[1] - one.g[0] * one.g[1]);
        out->G[2] = out->G[2] + w * (one.G[2] - one.g[1] * one.g[1]);
    }
    out->G[0] = out->G[0] + out->g[0] * out->g[0];
    if (k == 1) return;
    out->G[1] = out->G[1] + out->g[0] * out->g[1], out->G[2] = out->G[2] + out->g[1] * out->g[1];
}

INLINE void move_mean(const Moments *p, int n, int k, int held, const Gain *gain, double *b) { /* m + P H' g */
    for (int i = 0; i < n; i++) {
        if (held >> i & 1) continue;
        V moved = p->cross[i][0] * gain->g[0];
        if (k == 2) moved = moved + p->cross[i][1] * gain->g[1];
        AT(b, i) = AT(b, i) + moved;
    }
}

INLINE void reduce_cov(const Moments *p, int n, int k, int held, const Gain *gain, double *b) { /* P - P H' G H P */
    for (int i = 0; i < n; i++) {
        V x = p->cross[i][0] * gain->G[0], y = all(0.0);
        if (k == 2) {
            x = x + p->cross[i][1] * gain->G[1];
            y = p->cross[i][0] * gain->G[1] + p->cross[i][1] * gain->G[2];
        }
        for (int j = 0; j <= i; j++) {
            if (held >> i & held >> j & 1) continue;
            V loss = x * p->cross[j][0];
            if (k == 2) loss = loss + y * p->cross[j][1];
            AT(b, at(n, i, j)) = AT(b, at(n, i, j)) - loss;
        }
    }
}

INLINE void gain_of(const Filter *f, const Noise *noise, const Moments *p, int k, V u, V *probability, Gain *out) {
    if (f->update == COLLAPSED && noise->modes > 1) {
        collapsed_gain(p, noise, k, probability, out);
        return;
    }
    V R[3], edge = probability[0]; /* one mode, or the mode that each particle draws with the uniform number u */
    for (int i = 0; i < 3; i++) R[i] = noise->R[0][i];
    for (int j = 1; j < noise->modes; j++) {
        I below = less(u, edge);
        for (int i = 0; i < 3; i++) R[i] = pick(below, R[i], noise->R[j][i]);
        edge = edge + probability[j];
    }
    kalman_gain(p, k, R[0], R[1], R[2], out);
}

/* Update; of a bilinear sensor the covariance by the projection at the updated mean: see relinearised in
   gaussian_bank.py. The mode that a particle has drawn stays. */
INLINE void update(const Filter *f, const Reading *reading, const Noise *noise, int n, const Moments *p, V u,
                   V *probability, double *b) {
    int k = reading->g.k;
    Gain gain;
    gain_of(f, noise, p, k, u, probability, &gain);
    move_mean(p, n, k, reading->g.held, &gain, b);
    if (!reading->g.bilinear) {
        reduce_cov(p, n, k, reading->g.held, &gain, b);
        return;
    }
    Moments again;
    moments(&reading->g, n, f->scale, b, &again);
    for (int j = 0; j < k; j++) again.value[j] = p->value[j];
    if (f->update == COLLAPSED && noise->modes > 1) {
        V anew[MAX_MODES];
        likelihoods(&again, noise, k, anew);
        collapsed_gain(&again, noise, k, anew, &gain);
    } else {
        gain_of(f, noise, &again, k, u, probability, &gain);
    }
    reduce_cov(&again, n, k, reading->g.held, &gain, b);
}
#endif
