/* Noise of a sweep, estimated from its own readings: scan_noise.py describes the method. */
#pragma once

#include "surfels.h"

#define USUAL_SIGMA 0.004       /* of a URG-04LX at 0 [m], where nothing else is known ... */
#define USUAL_GROWTH 0.0009     /* ... and its growth per metre */
#define LEAST_SIGMA 0.0005      /* no reading is believed to be better [m]: half a millimetre's step */
#define LEAST_SPREAD 2.5e-4     /* variance of the quarters' ranges from which on noise may grow [m2] */
#define MAD 1.4826              /* standard deviation per median absolute deviation */
#define LIKELY_JITTER (0.1 * TAU / 360)  /* yaw jitter for which the estimate is best [rad] */
#define OUTLIER 4.0             /* a square this many times the likely one is a corner, not jitter ... */
#define LEFT 0.92               /* ... which leaves so much of the mean of normal errors' squares */
#define FLAT 0.97               /* least cosine of the normals beside a flat surface (14 deg) */
#define SIGNIFICANT 3.0         /* jitter is believed when it is so many times its error */

enum {
    LAG = 2,                    /* beams between three readings: next ones may share light */
    MIN_READINGS = 200,         /* fewer second differences estimate nothing */
    MOST_READINGS = 1200,       /* more are thinned out: the estimate is good to 4 % then */
    BINS = 256,                 /* of the ranges, to find their quarters */
    APART = 3,                  /* lines to either side of a flat surface */
    MIN_LINES = 10,             /* fewer triples of lines determine no jitter */
    ROUNDS = 3,                 /* of the estimate of what is likely */
};

/* The k-th smallest of `n` values, which are put into another order. */
static double smallest(double *values, int64_t n, int64_t k) {
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
    double high = smallest(values, n, n / 2);
    return n % 2 ? high : (smallest(values, n, n / 2 - 1) + high) / 2;
}

/* Write the quarter by size, 0 to 3, of each of `n` values; like values stay together. */
static void find_quarters(const double *values, int64_t n, uint8_t *quarters) {
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
        quarters[k] = (uint8_t)((up_to[(int)((values[k] - low) * scale)] - 1) * 4 / n);
}

/* Write the range sigma at 0 and its growth per metre. */
static void estimate_range_noise(const double *ranges, const uint8_t *valid, int64_t n_lines,
                                 int64_t n_beams, int64_t stride, double noise[2]) {
    noise[0] = USUAL_SIGMA, noise[1] = USUAL_GROWTH;
    int64_t whole = 0;
    for (int64_t i = 0; i < n_lines; i++) {
        const uint8_t *v = valid + i * stride;
        int32_t in_line = 0;
        for (int64_t j = LAG; j < n_beams - LAG; j++) in_line += v[j - LAG] & v[j] & v[j + LAG];
        whole += in_line;
    }
    if (whole < MIN_READINGS) return;

    /* second differences of some readings */
    int64_t step = whole / MOST_READINGS > 1 ? whole / MOST_READINGS : 1, next = 1, n = 0;
    double r[2 * MOST_READINGS], deviation[2 * MOST_READINGS], part[2 * MOST_READINGS];
    uint8_t quarters[2 * MOST_READINGS];
    for (int64_t i = 0; i < n_lines; i++)
        for (int64_t j = LAG; j < n_beams - LAG; j++) {
            const uint8_t *v = valid + i * stride + j;
            if (!(v[-LAG] & v[0] & v[LAG]) || --next > 0) continue;
            next = step;
            const double *at = ranges + i * stride + j;
            r[n] = at[0];
            double second = 1 / at[-LAG] - 2 / at[0] + 1 / at[LAG];
            deviation[n++] = fabs(second) * at[0] * at[0] * (MAD / sqrt(6.0));
        }

    /* a line through the medians of four quarters */
    double share[4] = {0}, x[4] = {0}, y[4] = {0}, x_mean = 0, y_mean = 0, spread = 0, slope = 0;
    find_quarters(r, n, quarters);
    for (int q = 0; q < 4; q++) {
        int64_t m = 0;
        double sum = 0;
        for (int64_t k = 0; k < n; k++)
            if (quarters[k] == q) part[m++] = deviation[k], sum += r[k];
        if (m == 0) continue;
        share[q] = (double)m / (double)n, x[q] = sum / (double)m, y[q] = smallest(part, m, m / 2);
        x_mean += share[q] * x[q], y_mean += share[q] * y[q];
    }
    for (int q = 0; q < 4; q++) {
        spread += share[q] * (x[q] - x_mean) * (x[q] - x_mean);
        slope += share[q] * (x[q] - x_mean) * y[q];
    }
    slope = spread > LEAST_SPREAD ? slope / spread : 0;
    slope = slope > y_mean / x_mean ? y_mean / x_mean : slope < 0 ? 0 : slope;
    double at_zero = y_mean - slope * x_mean;
    noise[0] = at_zero > LEAST_SIGMA ? at_zero : LEAST_SIGMA, noise[1] = slope;
}

static int is_flat(const double *a, const double *b) {
    return a[NX] * b[NX] + a[NY] * b[NY] + a[NZ] * b[NZ] > FLAT;
}

/* Write sum w l e and sum w l^2 of each line over its surfels (n_lines, 2). */
static void sum_line_residuals(const Sweep *sweep, const double *rows, const int32_t *index,
                               double *sums) {
    double *turns = malloc(sizeof *turns * (size_t)(2 * sweep->n_beams));
    memset(sums, 0, sizeof *sums * 2 * (size_t)sweep->n_lines);
    for (int64_t i = APART; turns && i < sweep->n_lines - APART; i++) {
        const int32_t *here = index + i * sweep->stride;
        int turned = 0;
        for (int64_t j = 0; j < sweep->n_beams; j++) {
            int32_t before = here[j - APART * sweep->stride], after = here[j + APART * sweep->stride];
            if (here[j] < 0 || before < 0 || after < 0) continue;
            if (!turned) turn_line(sweep->yaws + i * sweep->stride, sweep->n_beams, turns);
            turned = 1;
            const double *row = rows + SURFEL * here[j];
            if (!is_flat(row, rows + SURFEL * before) || !is_flat(row, rows + SURFEL * after)) continue;
            double c = turns[j], s = turns[sweep->n_beams + j];
            double x = row[X] - (c * sweep->lever[0] - s * sweep->lever[1]);
            double y = row[Y] - (s * sweep->lever[0] + c * sweep->lever[1]);
            double z = row[Z] - sweep->lever[2];
            double share = sweep->ranges[i * sweep->stride + j] / sqrt(x * x + y * y + z * z) - 1;
            double e = share * (x * row[NX] + y * row[NY] + z * row[NZ]);
            double swing = row[NY] * row[X] - row[NX] * row[Y];
            sums[2 * i] += swing / row[VARIANCE] * e;
            sums[2 * i + 1] += swing / row[VARIANCE] * swing;
        }
    }
    free(turns);
}

/* Standard deviation of the lines' yaws from the sums of `sum_line_residuals`; 0 if none is seen. */
static double estimate_yaw_jitter(const double *sums, int64_t n_lines) {
    double *square = malloc(sizeof *square * 2 * (size_t)n_lines), *expected = square + n_lines;
    int64_t n = 0;
    for (int64_t i = 0; square && i + 2 < n_lines; i++) {
        const double *s = sums + 2 * i;
        if (!(s[1] > 0 && s[3] > 0 && s[5] > 0)) continue;
        double second = s[0] / s[1] - 2 * s[2] / s[3] + s[4] / s[5];
        square[n] = second * second / 6;
        expected[n++] = (1 / s[1] + 4 / s[3] + 1 / s[5]) / 6;
    }
    double jitter = LIKELY_JITTER * LIKELY_JITTER, excess = 0, error = 0;
    for (int round = 0; round < ROUNDS && n >= MIN_LINES; round++) {
        double weights = 0, variance = 0;
        excess = 0;
        for (int64_t k = 0; k < n; k++) {
            double likely = expected[k] + jitter, weight = 1 / (likely * likely);
            double capped = square[k] < OUTLIER * likely ? square[k] : OUTLIER * likely;
            excess += weight * (capped / LEFT - expected[k]);
            variance += weight * expected[k] * weight * expected[k];
            weights += weight;
        }
        excess /= weights;
        jitter = excess > 0 ? excess : 0;
        error = sqrt(4 * variance) / weights;
    }
    free(square);
    return excess > SIGNIFICANT * error ? sqrt(excess) : 0;
}
