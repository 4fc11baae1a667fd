/* Noise of a sweep, estimated from its own readings: scan_noise.py describes the method. */
#pragma once

#include "surfels.h"

#define DEFAULT_SIGMA 0.004     /* range sigma of a URG-04LX at 0 m, if it cannot be estimated [m] */
#define DEFAULT_GROWTH 0.0009   /* its growth per metre */
#define MIN_SIGMA 0.0005        /* lower bound of range sigma [m]: half a millimetre's step */
#define MIN_RANGE_VARIANCE 2.5e-4   /* of the quartiles' mean ranges, to fit a growth with range [m2] */
#define MAD 1.4826              /* standard deviation per median absolute deviation */
#define SQUARES 924.0           /* sum of the squares of the SIXTH: variance of a difference of unit noise */
#define MAX_DEVIATION 3.0       /* of a difference, in standard deviations: beyond is an edge */
#define MAX_CORRELATION 8.0     /* of the correlation's factor */
#define TRUNCATED 2.5465        /* 8 / pi: the mean of a normal distribution cut off at 0, nearly */
#define MIN_SLOPE 0.1           /* of the range over the yaw, for the jitter [m/rad] */
#define MAX_INCIDENCE 1.73      /* tangent of incidence (60 deg): flatter ones are mostly limbs of round things */
#define EXPECTED_JITTER (0.1 * TAU / 360)   /* yaw jitter at which the estimate starts [rad] */
#define MAX_SQUARE_RATIO 4.0    /* cap of a squared difference, in expected ones: beyond is a corner */
#define CAPPED_SHARE 0.92       /* share of the mean square of normal errors that this cap leaves */

enum {
    REACH = 3,                  /* lines to each side that a sixth difference takes */
    SLOPE_REACH = 2,            /* lines to each side that a slope takes */
    BEAM_REACH = 4,             /* beams to each side, where lines have elevations of their own */
    MIN_READINGS = 200,         /* differences that an estimate needs */
    MAX_READINGS = 1200,        /* more are thinned out: this many give the estimate to 4 % */
    BINS = 256,                 /* of the histogram that finds the quartiles of the ranges */
    LAGS = 6,                   /* beams within which the noise may be correlated */
    FAR_LAG = 10,               /* beams apart, what is common to both is no range noise */
    MIN_LINES = 10,             /* lines that an estimate of the jitter needs */
    REWEIGHTINGS = 3,           /* iterations of the jitter's estimate */
};

static const double SIXTH[2 * REACH + 1] = {-1, 6, -15, 20, -15, 6, -1};

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
} Across;

/* Return what the sixth difference at a reading owes to the lines' own elevations. */
static double difference_by_elevation(const Sweep *sweep, const uint8_t *valid, int64_t i, int64_t j) {
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
            bend += SIXTH[REACH + k] * (ray[k * sweep->ray_stride + m] - ray[m]) * along[m];
    double rise = 1 / sweep->ranges[at + BEAM_REACH] - 1 / sweep->ranges[at - BEAM_REACH];
    return rise * bend / square;
}

/* Return the difference of line i at beam j, given the sixth difference of the yaws; a plane gives 0. */
static double difference_across(const Sweep *sweep, const uint8_t *valid, int64_t i, int64_t j, double bend,
                                double turn, double *slope) {
    double sum = 0, inverse[2 * REACH + 1];
    for (int k = -REACH; k <= REACH; k++) {
        int64_t at = (i + k) * sweep->stride + j;
        if (!valid[at]) return NAN;
        inverse[REACH + k] = 1 / sweep->ranges[at];
        sum += SIXTH[REACH + k] * inverse[REACH + k];
    }
    if (sweep->ray_stride > 0) sum -= difference_by_elevation(sweep, valid, i, j);
    double r = sweep->ranges[i * sweep->stride + j];
    double per_yaw = (inverse[REACH + SLOPE_REACH] - inverse[REACH - SLOPE_REACH]) / turn;
    *slope = r * r * per_yaw;
    return r * r * (sum - per_yaw * bend);
}

/* Inverse ranges of the lines around the one in work, NaN where there is no reading: line i is row i modulo
 * their number. Lines before `next` are known. */
typedef struct {
    double *rows;
    int64_t next;
} InverseRanges;

/* Write the inverse ranges of the lines about line i that are not known yet, and where each begins. */
static void invert_lines(const Sweep *sweep, const uint8_t *valid, int64_t i, InverseRanges *inverse,
                         const double *lines[2 * REACH + 1]) {
    enum { N = 2 * REACH + 1 };
    inverse->next = inverse->next > i - REACH ? inverse->next : i - REACH;
    for (; inverse->next <= i + REACH; inverse->next++) {
        const double *ranges = sweep->ranges + inverse->next * sweep->stride;
        const uint8_t *known = valid + inverse->next * sweep->stride;
        double *row = inverse->rows + inverse->next % N * sweep->n_beams;
        for (int64_t j = 0; j < sweep->n_beams; j++) row[j] = known[j] ? 1 / ranges[j] : NAN;
    }
    for (int k = 0; k < N; k++) lines[k] = inverse->rows + (i - REACH + k) % N * sweep->n_beams;
}

/* Write what `difference_across` gives for all of line i. */
static void difference_line(const Sweep *sweep, const uint8_t *valid, int64_t i, InverseRanges *inverse,
                            Across out) {
    const double *middle = sweep->yaws + sweep->n_beams / 2, *ranges = sweep->ranges + i * sweep->stride;
    const double *lines[2 * REACH + 1];
    double *restrict difference = out.difference, *restrict slope = out.slope;
    double bend = 0, turn = middle[(i + SLOPE_REACH) * sweep->stride]
                - middle[(i - SLOPE_REACH) * sweep->stride];
    for (int k = -REACH; k <= REACH; k++) bend += SIXTH[REACH + k] * middle[(i + k) * sweep->stride];
    invert_lines(sweep, valid, i, inverse, lines);

    /* sums across the lines, NaN where one has no reading, and slopes */
    const double *restrict before = lines[REACH - SLOPE_REACH], *restrict after = lines[REACH + SLOPE_REACH];
    for (int64_t j = 0; j < sweep->n_beams; j++) {
        double sum = 0, r = ranges[j];
        for (int k = 0; k <= 2 * REACH; k++) sum += SIXTH[k] * lines[k][j];
        sum = turn == 0 ? NAN : sum;
        slope[j] = isnan(sum) ? NAN : r * r * ((after[j] - before[j]) / turn);
        difference[j] = sum;
    }

    /* without what the lines' own elevations and the bend of their yaws add */
    for (int64_t j = 0; sweep->ray_stride > 0 && j < sweep->n_beams; j++)
        if (!isnan(difference[j])) difference[j] -= difference_by_elevation(sweep, valid, i, j);
    for (int64_t j = 0; j < sweep->n_beams; j++) {
        double r = ranges[j], per_yaw = (after[j] - before[j]) / turn;
        difference[j] = r * r * (difference[j] - per_yaw * bend);
    }
}

/* Write the range sigma at 0 m and its growth per metre. */
static void estimate_range_noise(const Sweep *sweep, const uint8_t *valid, double noise[2]) {
    noise[0] = DEFAULT_SIGMA, noise[1] = DEFAULT_GROWTH;
    int64_t n_lines = sweep->n_lines, n_beams = sweep->n_beams, whole = 0;
    for (int64_t i = REACH; i < n_lines - REACH; i++)
        for (int64_t j = 0; j < n_beams; j++) whole += valid[i * sweep->stride + j];
    if (whole < MIN_READINGS) return;

    /* sixth differences of inverse range */
    const double *middle = sweep->yaws + n_beams / 2;
    int64_t step = whole / MAX_READINGS > 1 ? whole / MAX_READINGS : 1, next = 1, n = 0;
    double r[2 * MAX_READINGS], deviation[2 * MAX_READINGS], part[2 * MAX_READINGS];
    uint8_t quartiles[2 * MAX_READINGS];
    for (int64_t i = REACH; i < n_lines - REACH; i++) {
        double bend = 0, slope, turn = middle[(i + SLOPE_REACH) * sweep->stride]
                                     - middle[(i - SLOPE_REACH) * sweep->stride];
        for (int k = -REACH; k <= REACH; k++) bend += SIXTH[REACH + k] * middle[(i + k) * sweep->stride];
        for (int64_t j = 0; j < n_beams; j++) {
            if (!valid[i * sweep->stride + j] || --next > 0) continue;
            next = step;
            if (turn == 0) continue;
            double found = difference_across(sweep, valid, i, j, bend, turn, &slope);
            if (isnan(found)) continue;
            r[n] = sweep->ranges[i * sweep->stride + j];
            deviation[n++] = fabs(found) * (MAD / sqrt(SQUARES));
        }
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
    noise[0] = at_zero > MIN_SIGMA ? at_zero : MIN_SIGMA, noise[1] = slope;
}

/* Products of a line's differences with those of beams farther on: their sums and numbers by the number of
 * beams between; those beyond FAR_LAG are not used. */
typedef struct {
    double sums[2 * LANES], counts[2 * LANES];
} Lagged;

/* Add the products of `n` differences, NaN where there is none. All lags of a beam are added at once, each sum
 * in the order of the beams. */
static void add_products(const double *restrict difference, int64_t n, Lagged *restrict lagged) {
    for (int64_t j = 0; j < n; j++) {
        double here = difference[j], beyond[2 * LANES];
        const double *others = difference + j;
        if (isnan(here)) continue;
        if (n - j < 2 * LANES) {    /* nothing beyond the last beam */
            for (int lag = 0; lag < 2 * LANES; lag++) beyond[lag] = lag < n - j ? others[lag] : NAN;
            others = beyond;
        }
        for (int lag = 0; lag < 2 * LANES; lag++) {
            double product = here * others[lag];
            lagged->sums[lag] += isnan(product) ? 0 : product;
            lagged->counts[lag] += isnan(product) ? 0 : 1;
        }
    }
}

/* Return the factor on the variance of a mean along a line for the noise's correlation between beams:
 * 1 + 2 sum rho_k. What beams FAR_LAG apart have in common is the yaw error of their lines. */
static double estimate_correlation(const Sweep *sweep, const uint8_t *valid, const double noise[2],
                                   InverseRanges inverse, Across line) {
    _Static_assert(FAR_LAG < 2 * LANES, "lags fit into two vectors");
    Lagged lagged = {0};
    int64_t n_beams = sweep->n_beams, step = sweep->n_lines * n_beams / (16 * MAX_READINGS);
    for (int64_t i = REACH; i < sweep->n_lines - REACH; i += step > 1 ? step : 1) {
        difference_line(sweep, valid, i, &inverse, line);
        for (int64_t j = 0; j < n_beams; j++) {
            double r = sweep->ranges[i * sweep->stride + j];
            double z = line.difference[j] / (sqrt(SQUARES) * (noise[0] + noise[1] * r));
            line.difference[j] = fabs(z) <= MAX_DEVIATION ? z : NAN;
        }
        add_products(line.difference, n_beams, &lagged);
    }
    const double *sums = lagged.sums, *counts = lagged.counts;
    if (counts[FAR_LAG] < MIN_READINGS) return 1;
    double common = sums[FAR_LAG] / counts[FAR_LAG], factor = 1, own = sums[0] / counts[0] - common;
    for (int lag = 1; lag < LAGS; lag++) factor += 2 * (sums[lag] / counts[lag] - common) / own;
    return factor > 1 ? factor < MAX_CORRELATION ? factor : MAX_CORRELATION : 1;
}

/* Return the yaw jitter of the lines, a standard deviation: see scan_noise.py. `lines` has room for the
 * differences and slopes of 2 REACH + 1 lines, `square` for 2 numbers per line. */
static double estimate_yaw_jitter(const Sweep *sweep, const uint8_t *valid, const double noise[3],
                                  InverseRanges inverse, Across *lines, double *square) {
    enum { N = 2 * REACH + 1 };
    double *expected = square + sweep->n_lines;
    double found = 0, assumed = 0;  /* variance of the sums that follow, by what is left and by the noise */
    int64_t n = 0;
    for (int64_t i = REACH; i < sweep->n_lines - REACH; i++) {
        difference_line(sweep, valid, i, &inverse, lines[i % N]);
        int64_t at = i - REACH;     /* the line in work: its neighbours' slopes are known */
        if (at < 2 * REACH) continue;

        /* regression of the line's differences on the slope, and what each line's error adds to it */
        double onto = 0, own = 0, shared[N] = {0}, by_noise = 0, by_both = 0, by_yaw = 0;
        const double *difference = lines[at % N].difference, *slope = lines[at % N].slope;
        for (int64_t j = 0; j < sweep->n_beams; j++) {
            double sigma = noise[0] + noise[1] * sweep->ranges[at * sweep->stride + j];
            double limit = sqrt(SQUARES) * (MAX_DEVIATION * sigma
                         + 3 * EXPECTED_JITTER * fabs(slope[j]));
            double steepest = MAX_INCIDENCE * sweep->ranges[at * sweep->stride + j];
            if (!(fabs(difference[j]) < limit) || !(fabs(slope[j]) > MIN_SLOPE)) continue;
            if (fabs(slope[j]) > steepest) continue;
            double w = 1 / (sigma * sigma), products[N];
            int whole = 1;
            for (int k = 0; k < N; k++) {
                products[k] = w * slope[j] * lines[(at + k - REACH) % N].slope[j];
                whole &= !isnan(products[k]);
            }
            if (!whole) continue;
            double score = w * slope[j] * difference[j], weight = w * slope[j] * slope[j];
            onto += score, own += weight;
            by_noise += score * score, by_both += score * weight, by_yaw += weight * weight;
            for (int k = 0; k < N; k++) shared[k] += products[k];
        }
        if (!(own > 0)) continue;
        double gain = 0;
        for (int k = 0; k < N; k++)
            gain += SIXTH[k] * SIXTH[k] * (shared[k] / own) * (shared[k] / own);
        double turn = onto / own;
        found += by_noise - 2 * turn * by_both + turn * turn * by_yaw, assumed += SQUARES * own;
        square[n] = turn * turn / gain;
        expected[n++] = SQUARES * noise[2] / own / gain;
    }

    /* noise where slopes are large: incidence makes it larger than elsewhere */
    double larger = assumed > 0 && found > assumed ? found / assumed : 1;
    for (int64_t k = 0; k < n; k++) expected[k] *= larger;

    /* excess over range noise, reweighted */
    double jitter = EXPECTED_JITTER * EXPECTED_JITTER, excess = 0, error = 0;
    for (int round = 0; round < REWEIGHTINGS && n >= MIN_LINES; round++) {
        double weights = 0, variance = 0;
        excess = 0;
        for (int64_t k = 0; k < n; k++) {
            double likely = expected[k] + jitter, weight = 1 / (likely * likely);
            double capped = square[k] < MAX_SQUARE_RATIO * likely ? square[k] : MAX_SQUARE_RATIO * likely;
            excess += weight * (capped / CAPPED_SHARE - expected[k]);
            variance += 2 * weight * likely * weight * likely;
            weights += weight;
        }
        excess /= weights;
        error = sqrt(SQUARES / 400 * variance) / weights;
        jitter = (excess + sqrt(excess * excess + TRUNCATED * error * error)) / 2;
    }
    return n < MIN_LINES ? 0 : sqrt(jitter);
}

/* Write the noise of a sweep where it is NaN: range sigma at 0 m, its growth per metre, the factor for
 * correlated beams and the sigma of a line's yaw. Return 0, or -1 if memory runs out. */
static int estimate_noise(const Sweep *sweep, const uint8_t *valid, double noise[NOISES]) {
    enum { N = 2 * REACH + 1 };
    size_t beams = (size_t)sweep->n_beams;
    double *room = malloc(sizeof *room * (3 * N * beams + 2 * (size_t)sweep->n_lines));
    if (!room) return -1;
    Across lines[N];
    for (size_t k = 0; k < N; k++) lines[k] = (Across){room + 2 * k * beams, room + (2 * k + 1) * beams};
    const InverseRanges inverse = {room + 2 * N * beams, 0};
    if (isnan(noise[RANGE_SIGMA])) estimate_range_noise(sweep, valid, noise);
    if (isnan(noise[CORRELATION])) noise[CORRELATION] = estimate_correlation(sweep, valid, noise, inverse, lines[0]);
    const double known[3] = {noise[RANGE_SIGMA], noise[RANGE_GROWTH], noise[CORRELATION]};
    if (isnan(noise[YAW_SIGMA]))
        noise[YAW_SIGMA] = estimate_yaw_jitter(sweep, valid, known, inverse, lines, room + 3 * N * beams);
    free(room);
    return 0;
}
