/* Noise of a sweep, estimated from its own readings: scan_noise.py describes the method. */
#pragma once

#include "yaw_jitter.h"

#define DEFAULT_SIGMA 0.004     /* range sigma of a URG-04LX at 0 m, if it cannot be estimated [m] */
#define DEFAULT_GROWTH 0.0009   /* its growth per metre */
#define MIN_SIGMA 0.0005        /* lower bound of range sigma [m]: half a millimetre's step */
#define MIN_RANGE_VARIANCE 2.5e-4   /* of the quartiles' mean ranges, to fit a growth with range [m2] */
#define MAD 1.4826              /* standard deviation per median absolute deviation */
#define MAX_CORRELATION 8.0     /* of the correlation's factor */

enum {
    MIN_READINGS = 200,         /* differences that an estimate needs */
    MAX_READINGS = 1200,        /* more are thinned out: this many give the estimate to 4 % */
    BINS = 256,                 /* of the histogram that finds the quartiles of the ranges */
    LAGS = 6,                   /* beams within which the noise may be correlated */
    FAR_LAG = 10,               /* beams apart, what is common to both is no range noise */
};

/* Return the k-th smallest of `n` values; reorders them. */
static double select_smallest(double *values, int64_t n, int64_t k) {
    int64_t low = 0, high = n - 1;
    while (low < high) {
        double pivot = values[low + (high - low) / 2];
        int64_t i = low, j = high;
        while (i <= j) {
            while (values[i] < pivot) i++;
            while (values[j] > pivot) j--;
            if (i <= j) {
                double swapped = values[i];
                values[i++] = values[j];
                values[j--] = swapped;
            }
        }
        if (k <= j) high = j;
        else if (k >= i) low = i;
        else break;
    }
    return values[k];
}

static double median(double *values, int64_t n) {
    double high = select_smallest(values, n, n / 2);
    return n % 2 ? high : (select_smallest(values, n, n / 2 - 1) + high) / 2;
}

/* Write the quartile, 0 to 3, of each of `n` values; equal values share one. */
static void assign_quartiles(const double *values, int64_t n, uint8_t *quartiles) {
    double low = values[0], high = values[0];
    for (int64_t k = 1; k < n; k++) {
        low = values[k] < low ? values[k] : low;
        high = values[k] > high ? values[k] : high;
    }
    double scale = BINS / (high - low + 1e-9);
    int64_t up_to[BINS + 1] = {0};
    for (int64_t k = 0; k < n; k++) up_to[(int)((values[k] - low) * scale)]++;
    for (int b = 1; b <= BINS; b++) up_to[b] += up_to[b - 1];
    for (int64_t k = 0; k < n; k++)
        quartiles[k] = (uint8_t)((up_to[(int)((values[k] - low) * scale)] - 1) * 4 / n);
}

/* Write the range sigma at 0 m and its growth per metre, by the `stencils` of the lines. */
static void estimate_range_noise(const Sweep *sweep, const uint8_t *valid, const Stencil *stencils,
                                 double noise[2]) {
    noise[RANGE_SIGMA] = DEFAULT_SIGMA, noise[RANGE_GROWTH] = DEFAULT_GROWTH;
    int64_t n_lines = sweep->n_lines, n_beams = sweep->n_beams, whole = 0;
    for (int64_t i = REACH; i < n_lines - REACH; i++)
        for (int64_t j = 0; j < n_beams; j++) whole += valid[i * sweep->stride + j];
    if (whole < MIN_READINGS) return;

    /* sixth differences of inverse range */
    int64_t step = whole / MAX_READINGS > 1 ? whole / MAX_READINGS : 1, next = 1, n = 0;
    double r[2 * MAX_READINGS], deviation[2 * MAX_READINGS], part[2 * MAX_READINGS];
    uint8_t quartiles[2 * MAX_READINGS];
    for (int64_t i = REACH; i < n_lines - REACH; i++)
        for (int64_t j = 0; j < n_beams; j++) {
            if (!valid[i * sweep->stride + j] || --next > 0) continue;
            next = step;
            double found = difference_across(sweep, valid, i, j, &stencils[i]);
            if (isnan(found)) continue;
            r[n] = sweep->ranges[i * sweep->stride + j];
            deviation[n++] = fabs(found) * (MAD / sqrt(SQUARES));
        }
    if (n < MIN_READINGS / 2) return;

    /* median of each quartile by range */
    double share[4] = {0}, x[4] = {0}, y[4] = {0}, x_mean = 0, y_mean = 0, spread = 0, slope = 0;
    assign_quartiles(r, n, quartiles);
    for (int q = 0; q < 4; q++) {
        int64_t m = 0;
        double sum = 0;
        for (int64_t k = 0; k < n; k++)
            if (quartiles[k] == q) part[m++] = deviation[k], sum += r[k];
        if (m == 0) continue;
        share[q] = (double)m / (double)n, x[q] = sum / (double)m, y[q] = select_smallest(part, m, m / 2);
        x_mean += share[q] * x[q], y_mean += share[q] * y[q];
    }

    /* fit sigma as a line in range */
    for (int q = 0; q < 4; q++) {
        spread += share[q] * (x[q] - x_mean) * (x[q] - x_mean);
        slope += share[q] * (x[q] - x_mean) * y[q];
    }
    slope = spread > MIN_RANGE_VARIANCE ? slope / spread : 0;
    slope = slope > y_mean / x_mean ? y_mean / x_mean : slope < 0 ? 0 : slope;
    double at_zero = y_mean - slope * x_mean;
    noise[RANGE_SIGMA] = at_zero > MIN_SIGMA ? at_zero : MIN_SIGMA, noise[RANGE_GROWTH] = slope;
}

/* Products of a line's differences with those of beams farther on: their sums and numbers by the number of
 * beams between; those beyond FAR_LAG are not used. */
typedef struct {
    double sums[2 * LANES], counts[2 * LANES];
} Lagged;

/* Add the products of `n` differences, NaN where there is none and for 2 LANES after the last. All lags of a
 * beam are added at once, each sum in the order of the beams. */
static void add_products(const double *difference, int64_t n, Lagged *lagged) {
    const Lanes one = {1, 1, 1, 1, 1, 1, 1, 1};
    Lanes sums[2] = {load(lagged->sums), load(lagged->sums + LANES)};
    Lanes counts[2] = {load(lagged->counts), load(lagged->counts + LANES)};
    for (int64_t j = 0; j < n; j++) {
        if (isnan(difference[j])) continue;
        for (int half = 0; half < 2; half++) {
            Lanes product = difference[j] * load(difference + j + half * LANES);
            sums[half] += where_known(product, product), counts[half] += where_known(product, one);
        }
    }
    for (int half = 0; half < 2; half++) {
        store(lagged->sums + half * LANES, sums[half]);
        store(lagged->counts + half * LANES, counts[half]);
    }
}

/* Add the products of line i, in standard deviations; `standard` has room for its differences and 2 LANES more. */
static void add_line_products(const Sweep *sweep, int64_t i, const double noise[2],
                              const double *restrict difference, double *restrict standard, Lagged *lagged) {
    const double *restrict ranges = sweep->ranges + i * sweep->stride;
    const double at_zero = noise[RANGE_SIGMA], growth = noise[RANGE_GROWTH];
    for (int64_t j = 0; j < sweep->n_beams; j++) {
        double z = difference[j] / (sqrt(SQUARES) * (at_zero + growth * ranges[j]));
        standard[j] = fabs(z) <= MAX_DEVIATION ? z : NAN;
    }
    for (int64_t j = sweep->n_beams; j < sweep->n_beams + 2 * LANES; j++) standard[j] = NAN;
    add_products(standard, sweep->n_beams, lagged);
}

/* Return the factor on the variance of a mean along a line for the noise's correlation between beams:
 * 1 + 2 sum rho_k. What beams FAR_LAG apart have in common is the yaw error of their lines. */
static double find_correlation(const Lagged *lagged) {
    _Static_assert(FAR_LAG < 2 * LANES, "lags fit into two vectors");
    const double *sums = lagged->sums, *counts = lagged->counts;
    if (counts[FAR_LAG] < MIN_READINGS) return 1;
    double common = sums[FAR_LAG] / counts[FAR_LAG], factor = 1, own = sums[0] / counts[0] - common;
    for (int lag = 1; lag < LAGS; lag++) factor += 2 * (sums[lag] / counts[lag] - common) / own;
    return factor > 1 ? factor < MAX_CORRELATION ? factor : MAX_CORRELATION : 1;
}

/* Write the noise of a sweep where it is NaN: range sigma at 0 m, its growth per metre, the factor for
 * correlated beams and the sigma of a line's yaw. Return 0, or -1 if memory runs out. */
static int estimate_noise(const Sweep *sweep, const uint8_t *valid, double noise[NOISES]) {
    const int correlated = isnan(noise[CORRELATION]), jittery = isnan(noise[YAW_SIGMA]);
    const size_t beams = (size_t)sweep->n_beams, n_lines = (size_t)sweep->n_lines;
    double *room = malloc(sizeof *room * ((3 * ACROSS + 1) * beams + 2 * LANES + 3 * n_lines));
    Stencil *stencils = malloc(sizeof *stencils * n_lines);
    if (!room || !stencils) {
        free(room);
        free(stencils);
        return -1;
    }
    weigh_lines(sweep, stencils);
    if (isnan(noise[RANGE_SIGMA])) estimate_range_noise(sweep, valid, stencils, noise);

    /* products and regressions of the lines' differences */
    Across lines[ACROSS];
    for (size_t k = 0; k < ACROSS; k++) lines[k] = (Across){room + 2 * k * beams, room + (2 * k + 1) * beams, NULL};
    InverseRanges inverse = {room + 2 * ACROSS * beams, 0};
    double *scratch = room + 3 * ACROSS * beams, *square = scratch + beams + 2 * LANES;
    Lagged lagged = {0};
    Regressions regressions = {0, square, square + n_lines, square + 2 * n_lines, 0, 0};
    int64_t step = sweep->n_lines * sweep->n_beams / (16 * MAX_READINGS);
    for (int64_t i = REACH; i < sweep->n_lines - REACH; i++) {
        int multiplied = correlated && (i - REACH) % (step > 1 ? step : 1) == 0;
        if (!multiplied && !jittery) continue;
        lines[i % ACROSS].stencil = &stencils[i];
        difference_line(sweep, valid, i, noise, &inverse, &lines[i % ACROSS]);
        if (multiplied) add_line_products(sweep, i, noise, lines[i % ACROSS].difference, scratch, &lagged);
        if (jittery && i >= 3 * REACH)  /* the slopes of the neighbours on both sides are known */
            add_regression(sweep, i - REACH, noise, lines, scratch, &regressions);
    }
    if (correlated) noise[CORRELATION] = find_correlation(&lagged);
    if (jittery) noise[YAW_SIGMA] = find_yaw_jitter(&regressions, noise[CORRELATION]);
    free(room);
    free(stencils);
    return 0;
}
