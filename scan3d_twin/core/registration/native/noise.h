/* Noise of a sweep, estimated from its own readings: scan_noise.py describes the method. */
#pragma once

#include "surfels.h"

#define DEFAULT_SIGMA 0.004     /* range sigma of a URG-04LX at 0 m, if it cannot be estimated [m] */
#define DEFAULT_GROWTH 0.0009   /* its growth per metre */
#define MIN_SIGMA 0.0005        /* lower bound of range sigma [m]: half a millimetre's step */
#define MIN_RANGE_VARIANCE 2.5e-4   /* of the quartiles' mean ranges, to fit a growth with range [m2] */
#define MAD 1.4826              /* standard deviation per median absolute deviation */
#define EXPECTED_JITTER (0.1 * TAU / 360)   /* yaw jitter at which the estimate starts [rad] */
#define MAX_SQUARE_RATIO 4.0    /* cap of a squared difference, in expected ones: beyond is a corner */
#define CAPPED_SHARE 0.92       /* share of the mean square of normal errors that this cap leaves */
#define MIN_FLAT_COSINE 0.97    /* between normals FLAT_LINES apart on a flat surface (14 deg) */
#define MIN_SIGNIFICANCE 3.0    /* jitter counts if its square is this many times the square's error */

enum {
    BEAM_LAG = 2,               /* beams between readings of a difference: adjacent ones share light */
    MIN_READINGS = 200,         /* second differences that an estimate needs */
    MAX_READINGS = 1200,        /* more are thinned out: this many give the estimate to 4 % */
    BINS = 256,                 /* of the histogram that finds the quartiles of the ranges */
    FLAT_LINES = 3,             /* a surface is flat if its normals this many lines apart agree */
    MIN_LINES = 10,             /* triples of lines that an estimate of the jitter needs */
    REWEIGHTINGS = 3,           /* iterations of the jitter's estimate */
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

/* Return the second difference of the inverse ranges of three beams that are unevenly spaced, with the noise
 * of one of evenly spaced beams. */
static double uneven_second_difference(const double *range, const double *ray) {
    double before = 0, after = 0;
    for (int i = 0; i < 3; i++) {
        double a = ray[i] - ray[i - 3 * BEAM_LAG], b = ray[i + 3 * BEAM_LAG] - ray[i];
        before += a * a, after += b * b;
    }
    before = sqrt(before), after = sqrt(after);
    double both = before + after, norm = sqrt((before * before + after * after + both * both) / 6);
    return (after / range[-BEAM_LAG] - both / range[0] + before / range[BEAM_LAG]) / norm;
}

/* Write the range sigma at 0 m and its growth per metre. */
static void estimate_range_noise(const Sweep *sweep, const uint8_t *valid, double noise[2]) {
    const double *ranges = sweep->ranges;
    int64_t n_lines = sweep->n_lines, n_beams = sweep->n_beams, stride = sweep->stride;
    noise[0] = DEFAULT_SIGMA, noise[1] = DEFAULT_GROWTH;
    int64_t whole = 0;
    for (int64_t i = 0; i < n_lines; i++) {
        const uint8_t *v = valid + i * stride;
        int32_t in_line = 0;
        for (int64_t j = BEAM_LAG; j < n_beams - BEAM_LAG; j++)
            in_line += v[j - BEAM_LAG] & v[j] & v[j + BEAM_LAG];
        whole += in_line;
    }
    if (whole < MIN_READINGS) return;

    /* second differences of inverse range */
    int64_t step = whole / MAX_READINGS > 1 ? whole / MAX_READINGS : 1, next = 1, n = 0;
    double r[2 * MAX_READINGS], deviation[2 * MAX_READINGS], part[2 * MAX_READINGS];
    uint8_t quartiles[2 * MAX_READINGS];
    for (int64_t i = 0; i < n_lines; i++)
        for (int64_t j = BEAM_LAG; j < n_beams - BEAM_LAG; j++) {
            const uint8_t *v = valid + i * stride + j;
            if (!(v[-BEAM_LAG] & v[0] & v[BEAM_LAG]) || --next > 0) continue;
            next = step;
            const double *at = ranges + i * stride + j;
            r[n] = at[0];
            double second = 1 / at[-BEAM_LAG] - 2 / at[0] + 1 / at[BEAM_LAG];
            if (sweep->ray_stride > 0)
                second = uneven_second_difference(at, sweep->rays + i * sweep->ray_stride + 3 * j);
            deviation[n++] = fabs(second) * at[0] * at[0] * (MAD / sqrt(6.0));
        }

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
    noise[0] = at_zero > MIN_SIGMA ? at_zero : MIN_SIGMA, noise[1] = slope;
}

/* Return whether two surfels have nearly the same normal. */
static int is_flat(const double *a, const double *b) {
    return a[NX] * b[NX] + a[NY] * b[NY] + a[NZ] * b[NZ] > MIN_FLAT_COSINE;
}

/* Write sum w l e and sum w l^2 of each line over its flat surfels (n_lines, 2): see scan_noise.py. */
static void sum_line_residuals(const Sweep *sweep, const double *rows, const int32_t *index,
                               double *sums) {
    double *turns = malloc(sizeof *turns * (size_t)(2 * sweep->n_beams));
    memset(sums, 0, sizeof *sums * 2 * (size_t)sweep->n_lines);
    for (int64_t i = FLAT_LINES; turns && i < sweep->n_lines - FLAT_LINES; i++) {
        const int32_t *here = index + i * sweep->stride;
        int turned = 0;
        for (int64_t j = 0; j < sweep->n_beams; j++) {
            int32_t before = here[j - FLAT_LINES * sweep->stride];
            int32_t after = here[j + FLAT_LINES * sweep->stride];
            if (here[j] < 0 || before < 0 || after < 0) continue;
            if (!turned) turn_line(sweep->yaws + i * sweep->stride, sweep->n_beams, turns);
            turned = 1;
            const double *row = rows + SURFEL * here[j];
            if (!is_flat(row, rows + SURFEL * before) || !is_flat(row, rows + SURFEL * after)) continue;

            /* residual, and its derivative by yaw */
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

/* Return the yaw jitter of the lines, a standard deviation, from the sums of `sum_line_residuals`; 0 if it
 * is not significant. */
static double estimate_yaw_jitter(const double *sums, int64_t n_lines) {
    double *square = malloc(sizeof *square * 2 * (size_t)n_lines), *expected = square + n_lines;
    int64_t n = 0;

    /* second differences of the lines' yaw errors */
    for (int64_t i = 0; square && i + 2 < n_lines; i++) {
        const double *s = sums + 2 * i;
        if (!(s[1] > 0 && s[3] > 0 && s[5] > 0)) continue;
        double second = s[0] / s[1] - 2 * s[2] / s[3] + s[4] / s[5];
        square[n] = second * second / 6;
        expected[n++] = (1 / s[1] + 4 / s[3] + 1 / s[5]) / 6;
    }

    /* excess over range noise, reweighted */
    double jitter = EXPECTED_JITTER * EXPECTED_JITTER, excess = 0, error = 0;
    for (int round = 0; round < REWEIGHTINGS && n >= MIN_LINES; round++) {
        double weights = 0, variance = 0;
        excess = 0;
        for (int64_t k = 0; k < n; k++) {
            double likely = expected[k] + jitter, weight = 1 / (likely * likely);
            double capped = square[k] < MAX_SQUARE_RATIO * likely ? square[k] : MAX_SQUARE_RATIO * likely;
            excess += weight * (capped / CAPPED_SHARE - expected[k]);
            variance += weight * expected[k] * weight * expected[k];
            weights += weight;
        }
        excess /= weights;
        jitter = excess > 0 ? excess : 0;
        error = sqrt(4 * variance) / weights;
    }
    free(square);
    return excess > MIN_SIGNIFICANCE * error ? sqrt(excess) : 0;
}
