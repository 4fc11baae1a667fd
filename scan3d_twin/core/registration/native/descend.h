/* The Gauss-Newton iteration: gauss_newton.py describes the method. */
#pragma once

#include "stretched_windows.h"

#define GATE_FACTOR 0.7         /* of gate and kernel from one step to the next */
#define FINAL_GATE 0.03         /* least gate [m]: a few times the range noise */
#define FIRST_KERNEL 4.0        /* robust kernel c of the first step [sigma] */
#define FINAL_KERNEL 1.5        /* least kernel [sigma] */
#define FIRST_COSINE 0.4        /* between the normals of a pair (66 deg) at which its weight is 0 at first, */
#define FINAL_COSINE 0.87       /* and at the least gate (30 deg): such pairs are of two faces that meet */
#define SAME_BASIN 0.010        /* poses that displace the source by less are one basin [m] */
#define USUAL_SPREAD 0.77       /* of errors that all readings share, in assumed ones: median of 105 pairs of sweeps */
#define MAX_SPREAD 1.4          /* of these, in usual ones, that fewer than 10 % of pairs of random scenes exceed */
#define EDGE_KERNEL_FACTOR 2.0  /* kernel of edges per kernel of surfels: their errors are uniform */

enum {
    MIN_PAIRS = 12,             /* correspondences that a reliable step needs */
    DAMPED_FROM = 15,           /* iteration from which half steps are taken, and must be small enough */
};

/* One Gauss-Newton step, and the equations that it solves. */
typedef struct {
    double step[POSE], nuisance_step[NUISANCES];
    double information[STATE * STATE];  /* left side of the equation, less the spurious share */
    double edges[STATE * STATE];        /* information of the edges */
    double patch_spread, spread;        /* of errors of patches, in assumed ones, and of those that all readings
                                         * share, in usual ones */
    Determined determined;
    Equations equations;
} Solution;

/* Return the RMS distance of the source's points, which makes rotations comparable with translations. */
static double find_reach(const Source *source) {
    return sqrt(source->second[0] + source->second[4] + source->second[8]);
}

/* Return the displacement between two poses of points at a distance `reach`. */
static double distance_between(const double *a, const double *b, double reach) {
    double square = 0;
    for (int i = 0; i < 3; i++) {
        square += (a[4 * i + 3] - b[4 * i + 3]) * (a[4 * i + 3] - b[4 * i + 3]);
        for (int j = 0; j < 3; j++) {
            double turned = reach * (a[4 * i + j] - b[4 * i + j]);
            square += turned * turned / 2;
        }
    }
    return sqrt(square);
}

/* Return the gate of a step, tightened from step to step. */
static Gate choose_gate(int64_t iteration, double widest) {
    double tight = 1, narrowest = FINAL_GATE < widest ? FINAL_GATE : widest;
    for (int64_t k = 0; k < iteration; k++) tight *= GATE_FACTOR;
    Gate gate = {tight * widest, FIRST_KERNEL * tight, FIRST_COSINE};
    if (gate.distance <= narrowest) gate.distance = narrowest, gate.cosine = FINAL_COSINE;
    gate.robust = gate.robust > FINAL_KERNEL ? gate.robust : FINAL_KERNEL;
    return gate;
}

/* Write L0, the information matrix of the prior on the estimated entries. */
static void find_prior_information(const Prior *prior, double *L0) {
    int n = (int)prior->n_entries;
    double covariance[STATE * STATE];
    memset(L0, 0, sizeof *L0 * STATE * STATE);
    if (prior->covariance[0] <= 0) return;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++)
            covariance[STATE * i + j] = prior->covariance[POSE * prior->entries[i] + prior->entries[j]];
    invert_information(covariance, n, 0, L0);
}

/* Return the share of the largest information below which a direction is unknown: 0 with a prior. */
static double least_share(const Prior *prior) {
    return prior->covariance[0] > 0 ? 0 : MIN_INFORMATION_SHARE;
}

/* Write the normal equations of the sample at T with their nuisances: the errors that readings share by
 * the model of shared_errors.py if `shared`, else by a factor. Errors of patches are `patch_factor` times as large
 * as assumed, and `sums` are those of an earlier call at T with these nuisances, or empty. Write the information by
 * which directions are tested, too. Return 0, or -1 if memory runs out. */
static int sum_pairs(const Target *target, const Sample *sample, const double *T, const double *nuisances,
                     Gate gate, const PairNoise *noise, const Prior *prior, int shared, double patch_factor,
                     Chunk *scratch, Equations *equations, Wide *state, double *tested, Sums *sums) {
    if (shared) {
        if (!sums->H && sum_shared_errors(target, sample, T, nuisances, gate, noise, prior, scratch, equations,
                                          sums) < 0) return -1;
        eliminate_patches(sums, patch_factor, state);
        for (int i = 0; i < prior->n_entries; i++)
            for (int j = 0; j < prior->n_entries; j++) tested[STATE * i + j] = state->H[WIDE * i + j];
        return 0;
    }
    build_equations(target, sample, T, nuisances, gate, noise, prior, scratch, equations);
    memcpy(tested, equations->information, sizeof equations->information);
    state->size = (int)equations->size;
    for (int i = 0; i < state->size; i++) {
        state->g[i] = equations->gradient[i];
        for (int j = 0; j < state->size; j++)
            state->H[WIDE * i + j] = equations->information[STATE * i + j]
                                   - equations->lost[STATE * i + j];
    }
    return 0;
}

/* Add what is known of the nuisances beforehand. */
static void add_nuisance_priors(const Prior *prior, const PairNoise *noise, const double *nuisances,
                                int shared, Wide *state) {
    for (int k = 0; k < prior->n_nuisances; k++)
        add_prior(state, (int)prior->n_entries + k, prior->nuisance_information[k], nuisances[k]);
    if (shared) add_shared_prior(noise, prior, state);
}

/* Write the Gauss-Newton step at T by the equation of gauss_newton.py, with the prior information L0;
 * `patch_factor` and `sums` as of sum_pairs. Return 0, or -1 if memory runs out. */
static int solve(const Target *target, const Source *source, const PairNoise *noise,
                 const Prior *prior, const double *L0, const double *T, const double *nuisances,
                 const Sample *sample, Gate gate, int shared, double patch_factor, Sums *sums,
                 Chunk *scratch, Solution *out) {
    int n = (int)prior->n_entries;
    const int64_t *entries = prior->entries;

    /* surfels, without degenerate directions and nuisances */
    Wide state;
    double tested[STATE * STATE], spurious[STATE * STATE];
    if (sum_pairs(target, sample, T, nuisances, gate, noise, prior, shared, patch_factor, scratch,
                  &out->equations, &state, tested, sums) < 0) return -1;
    memcpy(spurious, out->equations.spurious, sizeof spurious);
    find_determined(tested, spurious, entries, n, find_reach(source), &out->determined);
    if (out->determined.least_signal < MAX_STRETCH * MIN_SIGNAL_RATIO) {
        const PairNoise single = noise_of_readings(noise);
        add_stretched_windows(target, sample, T, nuisances, gate, shared ? &single : noise, prior, scratch,
                              spurious);
        find_determined(tested, spurious, entries, n, find_reach(source), &out->determined);
    }
    drop_directions(&out->determined, n, &state);
    Wide known = {.size = state.size};
    add_nuisance_priors(prior, noise, nuisances, shared, &state);
    eliminate_last(&state, n);
    double reduced[STATE * STATE];
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) reduced[STATE * i + j] = state.H[WIDE * i + j];

    /* edges and prior */
    double H[POSE * POSE] = {0}, g[POSE] = {0}, off[POSE];
    linearise_edges(target->edges, target->n_edges, source->edges, source->n_edges, T, gate.distance,
              EDGE_KERNEL_FACTOR * gate.robust, H, g);
    find_deviation(T, prior->mean, off);

    /* the equation */
    double left[STATE * STATE], right[STATE] = {0}, inverse[STATE * STATE], step[WIDE] = {0};
    project(out->determined.kept, reduced, n, left);
    project(out->determined.honest, reduced, n, out->information);
    for (int i = 0; i < n; i++) {
        right[i] = g[entries[i]];
        for (int j = 0; j < n; j++) {
            int at = STATE * i + j;
            out->edges[at] = H[POSE * entries[i] + entries[j]];
            left[at] += out->edges[at] + L0[at];
            out->information[at] += out->edges[at] + L0[at];
            right[i] += out->determined.kept[at] * state.g[j] + L0[at] * off[entries[j]];
        }
    }

    /* the step */
    invert_information(left, n, least_share(prior), inverse);
    memset(out->step, 0, sizeof out->step);
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) step[i] -= inverse[STATE * i + j] * right[j];
        out->step[entries[i]] = step[i];
    }
    for (int k = n; k < state.size; k++) step[k] = substitute(&state, k, step);
    memcpy(out->nuisance_step, step + n, sizeof *step * (size_t)prior->n_nuisances);

    /* are the errors that readings share as large as assumed? */
    out->patch_spread = out->spread = NAN;
    if (shared) {
        out->patch_spread = measure_patch_spread(sums, step);
        add_nuisance_priors(prior, noise, nuisances, 1, &known);
        for (int k = 0; k < prior->n_nuisances; k++) step[n + k] += nuisances[k];
        out->spread = measure_state_spread(&known, &state, step, n) / USUAL_SPREAD;
    }
    return 0;
}

/* Return the factor by which errors that all readings share are larger than assumed, whose spread is `ratio`
 * times the usual one; 1 if usual sweeps have such a spread. That the assumption counts, too, halves the excess. */
static double find_excess(double ratio) { return ratio > MAX_SPREAD ? ratio * ratio : 1; }

/* Return the factor that makes the assumed errors of patches as large as they are found, given their spread in
 * assumed ones. The assumption counts, too, which hides half of an excess. */
static double find_patch_factor(double spread) { return spread > 1 ? spread * spread : spread; }

/* Solve as `solve` does; in the last step with the errors that readings share, first as large as assumed, then
 * as large as they turn out. */
static int solve_step(const Target *target, const Source *source, const PairNoise *noise,
                      const Prior *prior, const double *L0, const double *T, const double *nuisances,
                      const Sample *sample, Gate gate, int64_t last, Chunk *scratch, Solution *out) {
    int shared = last && (noise->patch > 0 || noise->linearity > 0 || noise->offset > 0);
    Sums sums = {0};
    int failed = solve(target, source, noise, prior, L0, T, nuisances, sample, gate, shared, 1, &sums, scratch, out);
    if (!failed && shared) {
        double patch_spread = out->patch_spread, spread = out->spread, excess = find_excess(spread);
        PairNoise found = *noise;
        found.linearity *= excess, found.offset *= excess, found.height *= excess, found.lean *= excess;
        failed = solve(target, source, &found, prior, L0, T, nuisances, sample, gate, shared,
                       find_patch_factor(patch_spread), &sums, scratch, out);
        out->patch_spread = patch_spread, out->spread = spread;
    }
    free_sums(&sums);
    return failed;
}

/* Write covariance, information and degenerate directions of the result, from the last step's solution. */
static void write_result(const Source *source, const Prior *prior, const double *L0,
                     const Solution *solution, RunResult *out) {
    int n = (int)prior->n_entries;
    const int64_t *entries = prior->entries;
    double small[STATE * STATE], covariance[STATE * STATE] = {0}, information[STATE * STATE] = {0};
    invert_information(solution->information, n, least_share(prior), small);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            covariance[STATE * entries[i] + entries[j]] = small[STATE * i + j];
            information[STATE * entries[i] + entries[j]] = solution->information[STATE * i + j];
        }

    /* about the target's origin */
    double shift[STATE * STATE], back[STATE * STATE], transposed[STATE * STATE];
    double shifted[STATE * STATE], weighed[STATE * STATE];
    shift_to_target(out->T, 1, shift);
    shift_to_target(out->T, -1, back);
    for (int i = 0; i < POSE; i++)
        for (int j = 0; j < POSE; j++) transposed[STATE * i + j] = back[STATE * j + i];
    project(shift, covariance, POSE, shifted);
    project(transposed, information, POSE, weighed);
    for (int i = 0; i < POSE; i++)
        for (int j = 0; j < POSE; j++) {
            out->covariance[POSE * i + j] = shifted[STATE * i + j];
            out->information[POSE * i + j] = weighed[STATE * i + j];
        }

    /* degenerate directions, unless edges determine them */
    out->n_degenerate = 0;
    for (int m = 0; m < solution->determined.n_dropped; m++) {
        const double *v = solution->determined.dropped[m];
        if (quadratic(solution->edges, v, n) > quadratic(L0, v, n)) continue;
        double *row = out->degenerate + POSE * out->n_degenerate++;
        for (int i = 0; i < POSE; i++) {
            row[i] = 0;
            for (int j = 0; j < n; j++) row[i] += shift[STATE * i + entries[j]] * v[j];
        }
    }

    /* displacement of the source's points as they lie in the target's frame */
    const double *T = out->T;
    double first[3] = {0}, half[9] = {0}, second[9] = {0};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            first[i] += T[4 * i + j] * source->first[j];
            for (int k = 0; k < 3; k++) half[3 * i + j] += T[4 * i + k] * source->second[3 * k + j];
        }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 3; k++) second[3 * i + j] += half[3 * i + k] * T[4 * j + k];
    out->predicted_rmse = expect_displacement(first, second, covariance);
}

/* Return whether T lies in none of the basins of `n` other poses. */
static int is_new_basin(const double *T, const double *others, int64_t n, double reach) {
    for (int64_t k = 0; k < n; k++)
        if (distance_between(T, others + 16 * k, reach) <= SAME_BASIN) return 0;
    return 1;
}

/* Iterate from each of `n` starts (n, 4, 4) and write the distinct poses where they end; return their
 * number, or -1 if memory runs out. Ends without overlap are left out. `last` is the result of the last
 * start. */
static int64_t follow_starts(const Target *target, const Source *source, const PairNoise *noise,
                             const Prior *prior, const Criteria *criteria, const double *starts,
                             int64_t n, double *ends, RunResult *last) {
    double L0[STATE * STATE];
    int64_t n_ends = 0;
    Chunk *scratch = aligned_alloc(64, (sizeof *scratch + 63) / 64 * 64);
    Solution solution;
    if (!scratch) return -1;
    find_prior_information(prior, L0);
    for (int64_t start = 0; start < n; start++) {
        memset(last, 0, sizeof *last);
        memcpy(last->T, starts + 16 * start, sizeof last->T);
        const Sample *sample = &source->coarse;
        for (int64_t iteration = 0; iteration < criteria->max_iterations; iteration++) {
            Gate gate = choose_gate(iteration, criteria->max_correspondence_distance);
            int final = gate.distance <= FINAL_GATE && gate.robust <= FINAL_KERNEL;
            sample = last->settled ? &source->every : final ? &source->fine : &source->coarse;
            if (solve_step(target, source, noise, prior, L0, last->T, last->nuisances, sample, gate,
                           last->settled, scratch, &solution) < 0) {
                free(scratch);
                return -1;
            }

            /* move by the step, by half of it where pairs change back and forth */
            double share = iteration >= DAMPED_FROM && !last->settled ? 0.5 : 1, step[POSE];
            for (int k = 0; k < POSE; k++) step[k] = share * solution.step[k];
            displace(last->T, step, last->T);
            for (int k = 0; k < prior->n_nuisances; k++)
                last->nuisances[k] += share * solution.nuisance_step[k];
            last->iterations = iteration + 1;
            last->overlap = solution.equations.pairs >= MIN_PAIRS;
            if (last->settled || !last->overlap) break;

            /* converged? */
            const double *d = step;
            double shift = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
            double turn = sqrt(d[3] * d[3] + d[4] * d[4] + d[5] * d[5]);
            last->settled = final && shift < criteria->translation_epsilon
                         && turn < criteria->rotation_epsilon;
        }

        /* keep the pose of a new basin */
        last->pairs = solution.equations.pairs;
        last->square = solution.equations.square;
        last->spread = solution.spread;
        last->surfels = sample->count;
        if (last->overlap && is_new_basin(last->T, ends, n_ends, find_reach(source)))
            memcpy(ends + 16 * n_ends++, last->T, sizeof last->T);
    }
    write_result(source, prior, L0, &solution, last);
    free(scratch);
    return n_ends;
}
