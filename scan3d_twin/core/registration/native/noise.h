/* Noise of a sweep, estimated from its own readings: scan_noise.py describes the method. */
#pragma once

#include "stencil.h"
#include "surfels.h"

#define DEFAULT_SIGMA 0.004     /* range sigma of a URG-04LX at 0 m, if it cannot be estimated [m] */
#define DEFAULT_GROWTH 0.0009   /* its growth per metre */
#define MIN_SIGMA 0.0005        /* lower bound of range sigma [m]: half a millimetre's step */
#define MIN_RANGE_VARIANCE 2.5e-4   /* of the quartiles' mean ranges, to fit a growth with range [m2] */
#define MAD 1.4826              /* standard deviation per median absolute deviation */
#define MAX_DEVIATION 3.0       /* of a difference, in standard deviations: beyond is an edge */
#define MAX_JUMP 5.66           /* from line to line, beside the slope, in sigmas of a reading: 4 of a jump's */
#define MAX_CORRELATION 8.0     /* of the correlation's factor */
#define INDEPENDENT 400.0       /* of SQUARES: the share of the lines' squares that are as good as independent */
#define TRUNCATED 2.5465        /* 8 / pi: the mean of a normal distribution cut off at 0, nearly */
#define MIN_SLOPE 0.1           /* of the range over the yaw, for the jitter [m/rad] */
#define MAX_INCIDENCE 1.73      /* tangent of incidence (60 deg): flatter ones are mostly limbs of round things */
#define EXPECTED_JITTER (0.1 * TAU / 360)   /* yaw jitter before the sweep is seen; its square's mean [rad] */
#define MIN_CLEAR 0.2           /* share of a line's squared slopes that is not their noise */
#define MAX_SQUARE_RATIO 2.0    /* cap of a squared turn, in expected ones: beyond is a bend */
#define CAPPED_SHARE 0.742      /* share of the mean square of normal errors that this cap leaves */
#define CAPPED_VARIANCE 0.964   /* of a square so capped, by the square of its mean */

enum {
    BEAM_REACH = 4,             /* beams to each side, where lines have elevations of their own */
    MIN_READINGS = 200,         /* differences that an estimate needs */
    MAX_READINGS = 1200,        /* more are thinned out: this many give the estimate to 4 % */
    BINS = 256,                 /* of the histogram that finds the quartiles of the ranges */
    LAGS = 6,                   /* beams within which the noise may be correlated */
    FAR_LAG = 10,               /* beams apart, what is common to both is no range noise */
    MIN_LINES = 10,             /* lines that an estimate of the jitter needs */
    REWEIGHTINGS = 8,           /* iterations of the jitter's estimate */
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
static void leave_out_jumps(const Sweep *sweep, int64_t i, const double noise[2],
                            const double *const lines[ACROSS], Across *out) {
    const double *restrict ranges = sweep->ranges + i * sweep->stride;
    const double *yaw = sweep->yaws + i * sweep->stride + sweep->n_beams / 2;
    const double at_zero = noise[RANGE_SIGMA], growth = noise[RANGE_GROWTH];
    const int64_t reach = sweep->ray_stride > 0 ? BEAM_REACH : 0, n_beams = sweep->n_beams;
    double *restrict difference = out->difference, turns[ACROSS - 1];
    for (int k = 0; k < ACROSS - 1; k++)
        turns[k] = yaw[(k + 1 - REACH) * sweep->stride] - yaw[(k - REACH) * sweep->stride];
    for (int64_t j = reach; j < n_beams - reach; j++) {
        double r = ranges[j], slope = out->slope[j], per_yaw = slope / (r * r), most = 0;
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
    leave_out_jumps(sweep, i, noise, lines, out);
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

/* Regressions of the lines' differences on their slopes. */
typedef struct {
    int64_t n;
    double *square;         /* per line: square of the turn found, by what yaw errors of unit size give */
    double *own, *gain;     /* per line: weight of what is known of the turn, and what yaw errors give */
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
