/* Differences of the inverse range across seven lines of a sweep, which are noise: scan_noise.py says why. */
#pragma once

#include "stencil.h"
#include "surfels.h"

#define MAX_DEVIATION 3.0       /* of a difference, in standard deviations: beyond is an edge */
#define MAX_JUMP 5.66           /* of a step from line to line beside the slope, in sigmas: 4 of a step are 4 sqrt(2) */
#define EXPECTED_JITTER (0.1 * TAU / 360)   /* yaw jitter before the sweep is seen: root of its mean square [rad] */

enum {
    BEAM_REACH = 4,             /* beams to each side, where lines have elevations of their own */
};

/* Sixth differences of the inverse range across seven lines, times the square of the range, and its
 * slope over the yaw, likewise. Both are NaN where a line has no reading. */
typedef struct {
    double *difference, *slope;
    const Stencil *stencil;
} Across;

/* Return what the difference at a reading owes to the lines' own elevations. */
static double difference_by_elevation(const Sweep *sweep, const uint8_t *valid, int64_t i, int64_t j,
                                      const Stencil *stencil) {
    if (j < BEAM_REACH || j + BEAM_REACH >= sweep->n_beams) return NAN;
    int64_t at = i * sweep->stride + j;
    if (!valid[at - BEAM_REACH] || !valid[at + BEAM_REACH]) return NAN;
    const double *ray = sweep->rays + i * sweep->ray_stride + 3 * j;
    double along[3], square = 0, bend = 0;
    for (int m = 0; m < 3; m++) {
        along[m] = ray[m + 3 * BEAM_REACH] - ray[m - 3 * BEAM_REACH];
        square += along[m] * along[m];
    }
    for (int k = -REACH; k <= REACH; k++)
        for (int m = 0; m < 3; m++)
            bend += stencil->difference[REACH + k] * (ray[k * sweep->ray_stride + m] - ray[m]) * along[m];
    double rise = 1 / sweep->ranges[at + BEAM_REACH] - 1 / sweep->ranges[at - BEAM_REACH];
    return rise * bend / square;
}

/* Return the difference of line i at beam j; a plane gives 0. */
static double difference_across(const Sweep *sweep, const uint8_t *valid, int64_t i, int64_t j,
                                const Stencil *stencil) {
    double sum = 0;
    for (int k = 0; k < ACROSS; k++) {
        int64_t at = (i + k - REACH) * sweep->stride + j;
        if (!valid[at]) return NAN;
        sum += stencil->difference[k] / sweep->ranges[at];
    }
    if (sweep->ray_stride > 0) sum -= difference_by_elevation(sweep, valid, i, j, stencil);
    double r = sweep->ranges[i * sweep->stride + j];
    return r * r * sum;
}

/* Inverse ranges of the lines around the one in work, NaN where there is no reading: line i is row i modulo
 * their number. Lines before `next` are known. */
typedef struct {
    double *rows;
    int64_t next;
} InverseRanges;

/* Write the inverse ranges of the lines about line i that are not known yet, and where each begins. */
static void invert_lines(const Sweep *sweep, const uint8_t *valid, int64_t i, InverseRanges *inverse,
                         const double *lines[ACROSS]) {
    inverse->next = inverse->next > i - REACH ? inverse->next : i - REACH;
    for (; inverse->next <= i + REACH; inverse->next++) {
        const double *ranges = sweep->ranges + inverse->next * sweep->stride;
        const uint8_t *known = valid + inverse->next * sweep->stride;
        double *row = inverse->rows + inverse->next % ACROSS * sweep->n_beams;
        for (int64_t j = 0; j < sweep->n_beams; j++) row[j] = known[j] ? 1 / ranges[j] : NAN;
    }
    for (int k = 0; k < ACROSS; k++) lines[k] = inverse->rows + (i - REACH + k) % ACROSS * sweep->n_beams;
}

/* Make the differences of line i unknown where a surface ends among the seven lines: one reading of another
 * surface at their end passes for a yaw error, the same at all heights. */
static void leave_out_jumps(const Sweep *sweep, int64_t i, const double noise[2], const double *const lines[ACROSS],
                            const double *slopes, double *difference) {
    const double *restrict ranges = sweep->ranges + i * sweep->stride;
    const double *yaw = sweep->yaws + i * sweep->stride + sweep->n_beams / 2;
    const double at_zero = noise[RANGE_SIGMA], growth = noise[RANGE_GROWTH];
    const int64_t reach = sweep->ray_stride > 0 ? BEAM_REACH : 0, n_beams = sweep->n_beams;
    double turns[ACROSS - 1];
    for (int k = 0; k < ACROSS - 1; k++)
        turns[k] = yaw[(k + 1 - REACH) * sweep->stride] - yaw[(k - REACH) * sweep->stride];
    for (int64_t j = reach; j < n_beams - reach; j++) {
        double r = ranges[j], slope = slopes[j], per_yaw = slope / (r * r), most = 0;
        for (int k = 0; k < ACROSS - 1; k++) {
            double jump = fabs(lines[k + 1][j] - lines[k][j] - per_yaw * turns[k]);
            most = jump > most ? jump : most;
        }
        double limit = MAX_JUMP * (at_zero + growth * r + EXPECTED_JITTER * fabs(slope));
        if (reach > 0) limit += fabs(ranges[j + reach] - ranges[j - reach]) / (double)(2 * reach);
        difference[j] = most * r * r > limit ? NAN : difference[j];
    }
}

/* Write what `difference_across` gives for all of line i, and the slopes; no differences across jumps. */
static void difference_line(const Sweep *sweep, const uint8_t *valid, int64_t i, const double noise[2],
                            InverseRanges *inverse, Across *out) {
    const double *ranges = sweep->ranges + i * sweep->stride, *lines[ACROSS];
    double *restrict difference = out->difference, *restrict slope = out->slope;
    invert_lines(sweep, valid, i, inverse, lines);

    /* sums across the lines, NaN where one has no reading, and slopes */
    for (int64_t j = 0; j < sweep->n_beams; j++) {
        double sum = 0, per_yaw = 0, r = ranges[j];
        for (int k = 0; k < ACROSS; k++) {
            sum += out->stencil->difference[k] * lines[k][j];
            per_yaw += out->stencil->slope[k] * lines[k][j];
        }
        difference[j] = sum, slope[j] = r * r * per_yaw;
    }

    /* without what the lines' own elevations add */
    for (int64_t j = 0; sweep->ray_stride > 0 && j < sweep->n_beams; j++)
        if (!isnan(difference[j]))
            difference[j] -= difference_by_elevation(sweep, valid, i, j, out->stencil);
    for (int64_t j = 0; j < sweep->n_beams; j++) difference[j] *= ranges[j] * ranges[j];
    leave_out_jumps(sweep, i, noise, lines, slope, difference);
}
