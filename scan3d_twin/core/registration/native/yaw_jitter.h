/* Yaw jitter of the lines of a sweep, from their differences: scan_noise.py describes the method. */
#pragma once

#include "differences.h"

#define INDEPENDENT 400.0       /* of SQUARES lines, as many count as independent: differences overlap (assumption) */
#define TRUNCATED 2.5465        /* 8 / pi, for the mean of a normal distribution cut off at 0: exact for one about 0,
                                 * .64 times the mean where 0 is many deviations above its middle */
#define MIN_SLOPE 0.1           /* of the range over the yaw, for the jitter [m/rad] */
#define MAX_INCIDENCE 1.73      /* tangent of incidence (60 deg): flatter ones are mostly limbs of round things */
#define MIN_CLEAR 0.2           /* least share of a line's squared slopes that is not their noise */
#define MAX_SQUARE_RATIO 2.0    /* cap of a squared turn, in expected ones: beyond is a bend */
#define CAPPED_SHARE 0.742      /* share of the mean square of normal errors that this cap leaves */
#define CAPPED_VARIANCE 0.964   /* of a square so capped, by the square of its mean */

enum {
    MIN_LINES = 10,             /* lines that an estimate of the jitter needs */
    REWEIGHTINGS = 8,           /* iterations; the estimate may still fall a little where many lines lie on bends */
};

/* Regressions of the lines' differences on their slopes. */
typedef struct {
    int64_t n;
    double *square;         /* per line: square of the turn found, by what yaw errors of unit size give */
    double *own, *gain;     /* per line: weight of the turn, and the variance that yaw errors of unit size give it */
    double found, assumed;  /* variance of the lines' sums, by what the regressions leave and by the noise */
} Regressions;

/* Write the weight of each beam of line i in its regression, 0 where it takes no part: what differs by more
 * than noise and jitter do is an edge. `slopes` are those of the line and its neighbours, all known where it
 * takes part. */
static void weigh_beams(const Sweep *sweep, int64_t i, const double noise[2],
                        const double *restrict difference, const double *const slopes[ACROSS],
                        double *restrict weights) {
    const double *restrict slope = slopes[REACH], *restrict ranges = sweep->ranges + i * sweep->stride;
    const double at_zero = noise[RANGE_SIGMA], growth = noise[RANGE_GROWTH];
    for (int64_t j = 0; j < sweep->n_beams; j++) {
        double sigma = at_zero + growth * ranges[j], steep = fabs(slope[j]), known = 0;
        double limit = sqrt(SQUARES) * (MAX_DEVIATION * sigma + 3 * EXPECTED_JITTER * steep);
        for (int k = 0; k < ACROSS; k++) known += slopes[k][j];
        int counts = (fabs(difference[j]) < limit) & (steep > MIN_SLOPE)
                   & (steep <= MAX_INCIDENCE * ranges[j]) & !isnan(known);
        weights[j] = counts ? 1 / (sigma * sigma) : 0;
    }
}

/* Take what the noise of the slopes adds out of `shared`, the sums of products of line i's slopes with those of
 * each of the seven lines, in sigmas, of `n` beams. */
static void leave_out_slope_noise(const Across *lines, int64_t i, int64_t n, double shared[ACROSS]) {
    const double *slope = lines[i % ACROSS].stencil->slope;
    for (int k = -REACH; k <= REACH; k++) {
        const double *other = lines[(i + k) % ACROSS].stencil->slope;
        for (int m = k > 0 ? k : 0; m < (k < 0 ? ACROSS + k : ACROSS); m++)
            shared[REACH + k] -= (double)n * slope[m] * other[m - k];
    }
}

/* Add the regression of line i. `lines` are differences and slopes, line i in row i modulo their number;
 * `weights` has room for a number per beam. */
static void add_regression(const Sweep *sweep, int64_t i, const double noise[2], const Across *lines,
                           double *weights, Regressions *out) {
    const double *slopes[ACROSS], *difference = lines[i % ACROSS].difference;
    for (int k = 0; k < ACROSS; k++) slopes[k] = lines[(i + k - REACH) % ACROSS].slope;
    weigh_beams(sweep, i, noise, difference, slopes, weights);

    /* sums over the beams, and what each line's error adds to them */
    double onto = 0, own = 0, shared[ACROSS] = {0}, by_noise = 0, by_both = 0, by_yaw = 0;
    int64_t n = 0;
    for (int64_t j = 0; j < sweep->n_beams; j++) {
        double w = weights[j], slope = slopes[REACH][j];
        if (w == 0) continue;
        double score = w * slope * difference[j], weight = w * slope * slope;
        onto += score, own += weight, n++;
        by_noise += score * score, by_both += score * weight, by_yaw += weight * weight;
        for (int k = 0; k < ACROSS; k++) shared[k] += w * slope * slopes[k][j];
    }
    leave_out_slope_noise(lines, i, n, shared);
    double clear = shared[REACH], gain = 0;
    if (!(clear > MIN_CLEAR * own)) return;
    for (int k = 0; k < ACROSS; k++) {
        double moved = lines[i % ACROSS].stencil->difference[k] * shared[k] / clear;
        gain += moved * moved;
    }
    double fitted = onto / own, turn = onto / clear;
    out->found += by_noise - 2 * fitted * by_both + fitted * fitted * by_yaw, out->assumed += SQUARES * own;
    out->square[out->n] = turn * turn / gain;
    out->own[out->n] = clear * clear / own, out->gain[out->n++] = gain;
}

/* Return the yaw jitter of the lines, a standard deviation: see scan_noise.py. */
static double find_yaw_jitter(const Regressions *lines, double correlation) {
    const int64_t n = lines->n;
    const double *square = lines->square;
    double *expected = lines->own;  /* of `square`, by range noise */

    /* noise where slopes are large: incidence makes it larger than elsewhere */
    double larger = lines->assumed > 0 && lines->found > lines->assumed ? lines->found / lines->assumed : 1;
    for (int64_t k = 0; k < n; k++)
        expected[k] = SQUARES * correlation / lines->own[k] / lines->gain[k] * larger;

    /* excess over range noise, reweighted */
    const double expected_square = EXPECTED_JITTER * EXPECTED_JITTER;
    double jitter = expected_square;
    for (int round = 0; round < REWEIGHTINGS && n >= MIN_LINES; round++) {
        double weights = 0, excess = 0, variance = 0;
        for (int64_t k = 0; k < n; k++) {
            double likely = expected[k] + jitter, weight = 1 / (likely * likely);
            double capped = square[k] < MAX_SQUARE_RATIO * likely ? square[k] : MAX_SQUARE_RATIO * likely;
            excess += weight * (capped / CAPPED_SHARE - expected[k]);
            variance += CAPPED_VARIANCE * weight * likely * weight * likely;
            weights += weight;
        }
        variance *= SQUARES / INDEPENDENT / (weights * weights);
        double likeliest = excess / weights - variance / expected_square;
        jitter = (likeliest + sqrt(likeliest * likeliest + TRUNCATED * variance)) / 2;
    }
    return n < MIN_LINES ? 0 : sqrt(jitter);
}
