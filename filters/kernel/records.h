/* What became of a reading: the scalars of measurement_update (protocol.py) and normal_scores (noise.py). */
#ifndef USBLDR_RECORDS_H
#define USBLDR_RECORDS_H
#include <math.h>
#include "layout.h"

/* z with P(Z > z) = q for a standard normal Z and q <= 1/2: a start by Hastings' sheet 67, then Halley's method. */
static inline double upper_quantile(double q) {
    double t = sqrt(-2 * log(q));
    double z = t - (2.515517 + t * (0.802853 + t * 0.010328)) / (1 + t * (1.432788 + t * (0.189269 + t * 0.001308)));
    for (int i = 0; i < 2; i++) { /* from 5e-4 to 1e-10 to rounding */
        double step = (0.5 * erfc(z * 0.70710678118654752) - q) / (0.3989422804014327 * exp(-0.5 * z * z));
        z += step / (1 - 0.5 * z * step);
    }
    return z;
}

/* The quantile of N(0, 1) that a value has in sum w_j N(mean_j, variance_j). */
static inline double normal_score(double value, int modes, const double *w, const double *mean, const double *variance) {
    double below = 0, above = 0;
    for (int j = 0; j < modes; j++) {
        double t = (value - mean[j]) / sqrt(2 * variance[j]);
        below += w[j] * erfc(-t) / 2, above += w[j] * erfc(t) / 2;
    }
    double z = upper_quantile(fmax(fmin(below, above), 1e-300));
    return below < above ? -z : z;
}

/* Scores of the innovation e with predicted covariance P (xx, xy, yy); SINGULAR if there are none. */
static inline int normal_scores(const Reading *reading, const double *e, const double *P, double *score) {
    int k = reading->g.k, modes = reading->modes;
    double mean[MAX_MODES] = {0}, variance[MAX_MODES], w[MAX_MODES], rest[MAX_MODES];
    if (modes == 1) {
        double xx = P[0] + reading->noise.R[0][0], xy = P[1] + reading->noise.R[0][1], yy = P[2] + reading->noise.R[0][2];
        if (!(xx > 0)) return SINGULAR;
        score[0] = e[0] / sqrt(xx);
        if (k == 1) return GOOD;
        double slope = xy / sqrt(xx), left = yy - slope * slope;
        if (!(left > 0)) return SINGULAR;
        score[1] = (e[1] - slope * score[0]) / sqrt(left);
        return GOOD;
    }
    for (int j = 0; j < modes; j++) variance[j] = P[0] + reading->noise.R[j][0];
    score[0] = normal_score(e[0], modes, reading->noise.probability, mean, variance);
    if (k == 1) return GOOD;
    double top = -INFINITY, sum = 0;
    for (int j = 0; j < modes; j++) {
        double xy = P[1] + reading->noise.R[j][1], yy = P[2] + reading->noise.R[j][2], slope = xy / variance[j];
        w[j] = reading->noise.log_probability[j] - 0.5 * (e[0] * e[0] / variance[j] + log(variance[j]));
        top = fmax(top, w[j]);
        mean[j] = slope * e[0], rest[j] = yy - slope * xy;
        if (!(rest[j] > 1e-15 * yy)) return SINGULAR; /* ROUNDING */
    }
    for (int j = 0; j < modes; j++) sum += w[j] = exp(w[j] - top);
    for (int j = 0; j < modes; j++) w[j] /= sum;
    score[1] = normal_score(e[1], modes, w, mean, rest);
    return GOOD;
}

/* Posterior probability that the measurement is no outlier. */
static inline double nominal_probability(const Reading *reading, const double *e, const double *P) {
    double log_joint[MAX_MODES], top = -INFINITY, sum = 0, nominal = 0;
    for (int j = 0; j < reading->modes; j++) {
        double xx = P[0] + reading->noise.R[j][0], det = xx, distance = e[0] * e[0] / xx;
        if (reading->g.k == 2) {
            double xy = P[1] + reading->noise.R[j][1], yy = P[2] + reading->noise.R[j][2];
            det = xx * yy - xy * xy;
            distance = (yy * e[0] * e[0] - 2 * xy * e[0] * e[1] + xx * e[1] * e[1]) / det;
        }
        log_joint[j] = reading->noise.log_probability[j] - 0.5 * (log(det) + distance);
        top = fmax(top, log_joint[j]);
    }
    for (int j = 0; j < reading->modes; j++) {
        double p = exp(log_joint[j] - top);
        sum += p, nominal += reading->noise.nominal[j] * p;
    }
    return nominal / sum;
}

static inline int write_record(const Reading *reading, const double *e, const double *P, double *out) {
    int k = reading->g.k;
    double mixture[3] = {0, 0, 0};
    for (int j = 0; j < reading->modes; j++)
        for (int i = 0; i < 3; i++) mixture[i] += reading->noise.probability[j] * reading->noise.R[j][i];
    for (int j = 0; j < k; j++) {
        out[E + j] = e[j];
        out[SD + j] = sqrt(P[2 * j] + mixture[2 * j]);
        out[NOMINAL_SD + j] = sqrt(P[2 * j] + reading->noise.R[0][2 * j]);
    }
    out[NOMINAL] = nominal_probability(reading, e, P);
    return normal_scores(reading, e, P, out + SCORE);
}
#endif
