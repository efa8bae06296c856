/* Resampling, the Markov chain Monte Carlo move, and the loop over steps: step (4) of the paper, see cpf.py. */
#include "fixes.h"
#include "guard.h"
#include "span.h"

static void gather(const Work *w, double **bank, double **spare, const int *ancestor) {
    for (int i = 0; i < w->blocks * LANES; i++) {
        const double *from = *bank + ancestor[i] / LANES * w->block + ancestor[i] % LANES;
        double *to = *spare + i / LANES * w->block + i % LANES;
        for (int q = 0; q < w->block; q += LANES) to[q] = from[q];
    }
    double *filled = *spare;
    *spare = *bank, *bank = filled;
}

/* Systematic resampling of the bank and of its past (resampling.py); equal weights after it. */
static int resample(Work *w) {
    int N = w->N, padded = w->blocks * LANES, *ancestor = malloc(sizeof(int) * (size_t)padded);
    double *edge = malloc(sizeof(double) * (size_t)padded), sum = 0, offset = uniform(&w->random);
    if (!ancestor || !edge) {
        free(ancestor), free(edge);
        return NO_MEMORY;
    }
    for (int i = 0; i < N; i++) edge[i] = sum += w->weight[i];
    for (int i = 0; i < N; i++) edge[i] *= N / sum;
    edge[N - 1] = N; /* rounding below the last pointer would index past the end */
    for (int i = 0, j = 0; i < N; i++) {
        while (edge[j] <= i + offset && j < N - 1) j++;
        ancestor[i] = j;
    }
    for (int i = N; i < padded; i++) ancestor[i] = 0;
    gather(w, &w->bank, &w->spare, ancestor);
    for (int p = 0; p < w->past; p++) {
        gather(w, &w->start[p], &w->spare, ancestor);
        for (int i = 0; i < N; i++) edge[i] = w->past_log[p][ancestor[i]];
        memcpy(w->past_log[p], edge, sizeof(double) * (size_t)N);
    }
    for (int i = 0; i < N; i++) w->log_weight[i] = -log(N), w->weight[i] = 1.0 / N;
    free(ancestor), free(edge);
    return GOOD;
}

/* Propose new modes for the past steps; accept with min(1, product of l* / product of l). Return the share accepted. */
static double move(Work *w) {
    int padded = w->blocks * LANES, accepted = 0;
    size_t bytes = sizeof(double) * (size_t)(w->blocks * w->block);
    double *state = w->spare;
    memcpy(state, w->start[0], bytes);
    for (int p = 0; p < w->past; p++) {
        memcpy(w->proposal[p], state, bytes);
        memset(w->proposed_log[p], 0, sizeof(double) * (size_t)padded);
        predict_bank(w, w->past_step[p], state);
        for (int r = 0; r < w->past_step[p]->readings; r++) {
            const Reading *reading = w->past_reading[p] + r;
            Noise noise;
            noise_of(reading, 0, &noise);
            project_bank(w, reading, &noise, state);
            for (int i = 0; i < w->N; i++) w->proposed_log[p][i] += w->log_likelihood[i];
            update_bank(w, reading, &noise, state);
        }
    }
    for (int i = 0; i < w->N; i++) {
        double gain = 0;
        for (int p = 0; p < w->past; p++) gain += w->proposed_log[p][i];
        for (int p = 0; p < w->past; p++) gain -= w->past_log[p][i];
        if (!(log(uniform(&w->random)) < gain)) continue;
        accepted++;
        size_t first = (size_t)(i / LANES * w->block + i % LANES);
        for (int q = 0; q < w->block; q += LANES) {
            w->bank[first + q] = state[first + q];
            for (int p = 0; p < w->past; p++) w->start[p][first + q] = w->proposal[p][first + q];
        }
        for (int p = 0; p < w->past; p++) w->past_log[p][i] = w->proposed_log[p][i];
    }
    return (double)accepted / w->N;
}

/* Use one reading: record, weigh, resample, update, shift of the mean. */
static int use(Work *w, const Reading *reading, double *out) {
    const Filter *f = w->f;
    Noise noise;
    double before[MAX_STATES], after[MAX_STATES];
    noise_of(reading, f->update == MATCHED, &noise);
    project_bank(w, reading, &noise, w->bank);
    int status = record(w, reading, noise.modes, out);
    if (status != GOOD) return status;
    if (reading->fix) mean_of(w, before);
    if (f->update == DRAWN) {
        double size = reweigh(w), *log_l = w->past_log[w->past - 1];
        for (int i = 0; i < w->N; i++) log_l[i] += w->log_likelihood[i];
        w->least = fmin(w->least, size);
        if (size < f->resample_below * w->N) {
            if ((status = resample(w)) != GOOD) return status;
            project_bank(w, reading, &noise, w->bank);
            w->resampled = 1;
        }
    }
    update_bank(w, reading, &noise, w->bank);
    if (reading->fix) {
        mean_of(w, after);
        for (int i = 0; i < w->n; i++) out[SHIFT + i] = after[i] - before[i];
    }
    return GOOD;
}

/* Keep the bank before a step as the newest past step; forget the oldest if there are too many. */
static void remember(Work *w, const Step *step, const Reading *readings) {
    if (w->past == w->depth) {
        double *oldest = w->start[0], *log_l = w->past_log[0];
        for (int p = 1; p < w->depth; p++) {
            w->start[p - 1] = w->start[p], w->past_log[p - 1] = w->past_log[p];
            w->past_step[p - 1] = w->past_step[p], w->past_reading[p - 1] = w->past_reading[p];
        }
        w->start[w->depth - 1] = oldest, w->past_log[w->depth - 1] = log_l;
        w->past--;
    }
    int p = w->past++;
    memcpy(w->start[p], w->bank, sizeof(double) * (size_t)(w->blocks * w->block));
    memset(w->past_log[p], 0, sizeof(double) * (size_t)(w->blocks * LANES));
    w->past_step[p] = step, w->past_reading[p] = readings;
}

/* state: the bank; with DRAWN also the starts of the past steps, log weights and weights (which rounding makes differ
   from their exponentials, so that a span would depend on where it is cut), log likelihoods of the past steps. */
static void exchange(Work *w, double *state, int out) {
    size_t bank = (size_t)(w->blocks * w->block), lanes = (size_t)(w->blocks * LANES);
    double *parts[1 + 4 + 2 + 4];
    size_t sizes[1 + 4 + 2 + 4];
    int count = 0;
    parts[count] = w->bank, sizes[count++] = bank;
    for (int p = 0; p < w->depth; p++) parts[count] = w->start[p], sizes[count++] = bank;
    if (w->depth) parts[count] = w->log_weight, sizes[count++] = lanes, parts[count] = w->weight, sizes[count++] = lanes;
    for (int p = 0; p < w->depth; p++) parts[count] = w->past_log[p], sizes[count++] = lanes;
    for (int i = 0; i < count; state += sizes[i++])
        out ? memcpy(state, parts[i], 8 * sizes[i]) : memcpy(parts[i], state, 8 * sizes[i]);
}

static int run_steps(Work *w, const Step *step, int count, const Reading *reading, const Guard *guard, double *estimates,
                     double *records) {
    int width = w->n + w->n * w->n + 2;
    for (int s = 0; s < count; s++, step++) {
        double acceptance = NAN, *before = estimates, log_relocation = guard ? guard->log_relocation[s] : NAN;
        if (!isnan(log_relocation) &&
            calls_for_hypotheses(w->f, step, reading, before, guard->outlier_m2, log_relocation))
            return s;
        w->random.of = step, w->least = w->N, w->resampled = 0;
        if (w->depth) remember(w, step, reading);
        predict_bank(w, step, w->bank);
        for (int r = 0; r < step->readings; r++, reading++, records += SHIFT + w->n) {
            int status = use(w, reading, records);
            if (status != GOOD) return status;
        }
        if (w->resampled && w->f->move_steps) acceptance = move(w);
        estimate(w, estimates += width);
        estimates[width - 1] = acceptance;
    }
    return count;
}

static int advance(const Filter *f, const Step *steps, int past, int count, const Reading *readings, const Guard *guard,
                   double *state, double *estimates, double *records) {
    Work w;
    memset(&w, 0, sizeof w);
    w.f = f;
    w.n = f->n, w.N = f->N, w.block = (f->n + f->n * (f->n + 1) / 2) * LANES;
    w.blocks = (f->N + LANES - 1) / LANES, w.groups = (f->N + W - 1) / W;
    w.depth = f->update != DRAWN ? 0 : f->move_steps > 1 ? f->move_steps : 1;
    size_t bank = (size_t)(w.blocks * w.block), lanes = (size_t)(w.blocks * LANES);
    size_t scratch = (size_t)(w.groups * W) * (size_t)scratch_size(f->n, 2, MAX_MODES);
    double *memory = malloc(8 * ((size_t)(2 + 2 * w.depth) * bank + (size_t)(4 + 2 * w.depth) * lanes + scratch) + 64);
    if (!memory) return NO_MEMORY;
    double *next = (double *)(((uintptr_t)memory + 63) / 64 * 64);
    w.bank = next, w.spare = next + bank, next += 2 * bank;
    for (int p = 0; p < w.depth; p++, next += 2 * bank) w.start[p] = next, w.proposal[p] = next + bank;
    w.log_weight = next, w.weight = next + lanes, w.log_likelihood = next + 2 * lanes, w.uniform = next + 3 * lanes;
    next += 4 * lanes;
    for (int p = 0; p < w.depth; p++, next += 2 * lanes) w.past_log[p] = next, w.proposed_log[p] = next + lanes;
    w.scratch = next;
    exchange(&w, state, 0);
    for (size_t i = 0; i < lanes; i++) w.uniform[i] = 0.0;
    if (!w.depth)
        for (size_t i = 0; i < lanes; i++) w.weight[i] = (int)i < w.N;
    for (; w.past < past; w.past++, steps++) {
        w.past_step[w.past] = steps, w.past_reading[w.past] = readings;
        readings += steps->readings;
    }
    int status = run_steps(&w, steps, count, readings, guard, estimates, records);
    exchange(&w, state, 1);
    free(memory);
    return status;
}
