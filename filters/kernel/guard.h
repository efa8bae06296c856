/* Whether the fixes of a step call for hypotheses: what multi_hypothesis.py asks of hypotheses.py while it
   holds the one hypothesis that all is well. If they may, Python takes the step, and decides. */
#ifndef USBLDR_GUARD_H
#define USBLDR_GUARD_H
#include "updates.h"

/* Log density of a Gaussian, and of Student's t with 4 degrees of freedom, at e in two dimensions. */
static double log_density(const double *e, const double *P, const double *R, int student) {
    double xx = P[0] + R[0], xy = P[1] + R[1], yy = P[2] + R[2], det = xx * yy - xy * xy;
    double distance = (yy * e[0] * e[0] - 2 * xy * e[0] * e[1] + xx * e[1] * e[1]) / det;
    return -1.8378770664093453 - 0.5 * log(det) - (student ? 3 * log1p(distance / 4) : 0.5 * distance);
}

/* Innovation e of both axes of a fix and its covariance P (xx, xy, yy), linearised, for the Gaussian in b. */
static void predict_fix(const Reading *east, const Reading *north, int n, const double *b, double *e, double *P) {
    Function g = east->g;
    Moments fix;
    if (g.k == 1 && g.kind == SELECTED) g.row[1] = north->g.row[0];
    g.k = 2;
    moments(&g, n, 0.0, b, &fix);
    e[0] = east->z[0] - first_of(fix.value[0]), e[1] = north->z[1] - first_of(fix.value[1]);
    for (int i = 0; i < 3; i++) P[i] = first_of(fix.cov[(i + 1) / 2][i / 2]);
}

static int calls_for_hypotheses(const Filter *f, const Step *step, const Reading *reading, const double *before,
                                double outlier_m2, double log_relocation) {
    double b[(MAX_STATES + MAX_STATES * (MAX_STATES + 1) / 2) * LANES], inlier = 0, relocated = 0;
    int n = f->n, informative = 0;
    Motion m;
    for (int i = 0; i < n; i++) {
        AT(b, i) = all(before[i]);
        for (int j = 0; j <= i; j++) AT(b, at(n, i, j)) = all(before[n + i * n + j]);
    }
    motion_of(f, step, &m);
    if (step->dt_s != 0.0) predict(&m, 0.0, n, b);
    for (int r = 0; r < step->readings; r++) {
        if (reading[r].fix != USBL_FIX) continue;
        const Reading *east = &reading[r], *north = east->g.k == 2 ? east : &reading[++r];
        double e[2], P[3], R[3], first[3], top = -INFINITY, sum = 0, log_joint[MAX_MODES * MAX_MODES];
        int modes = 0, inliers = 0;
        predict_fix(east, north, n, b, e, P);
        for (int j = 0; j < east->modes; j++)
            for (int l = 0; l < (north == east ? 1 : north->modes); l++, modes++) {
                double log_p = east->noise.log_probability[j] + (north == east ? 0.0 : north->noise.log_probability[l]);
                R[0] = east->noise.R[j][0], R[1] = north == east ? east->noise.R[j][1] : 0.0;
                R[2] = north == east ? east->noise.R[j][2] : north->noise.R[l][2];
                if (!modes) memcpy(first, R, sizeof R);
                if ((R[0] + R[2]) / 2 > fmax(outlier_m2, (first[0] + first[2]) / 2)) continue; /* an outlier itself */
                log_joint[inliers] = log_p + log_density(e, P, R, 0);
                top = fmax(top, log_joint[inliers++]);
            }
        for (int j = 0; j < inliers; j++) sum += exp(log_joint[j] - top);
        inlier += top + log(sum), relocated += log_density(e, P, first, 1);
        informative |= !(P[0] + P[2] <= first[0] + first[2]);
    }
    return informative || !(log_relocation + relocated <= inlier - 1e-9); /* Python decides what is as close as that */
}
#endif
