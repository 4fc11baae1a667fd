/* Normal equations with the errors that readings share: shared_errors.py describes the model. */
#pragma once

#include "algebra.h"

#define KNOT_SPACING 0.25       /* of the range error's curve over range [m] */
#define CURVE_LENGTH 0.25       /* range over which the curve changes [m] */
#define MIN_CURVE_SIGMA 1e-4    /* keeps its covariance regular [m] */

enum {
    COLUMNS = 24, BANDS = 12,   /* patches: 15 deg of azimuth by a twelfth of the sphere's height */
    PATCH_ERRORS = 3,           /* of a patch: its mean, and its slopes along azimuth and height */
    ASSUMED = 4,
    NONZERO = PATCH_ERRORS + POSE + 1 + 4,  /* derivatives of a residual */
};

/* Derivatives of a residual by the unknowns that it depends on, ascending. */
typedef struct {
    int count, unknown[NONZERO];
    double by[NONZERO];
} Derivatives;

/* Normal equations of patches and state while they are summed up: the lower triangle of (size, size). */
typedef struct {
    int size, state;            /* unknowns, and the first of the state */
    int row_of[COLUMNS * BANDS];
    double *H, *g;
    double *whole;              /* `H` and `g` before anything was eliminated */
    double *h, residual, square;    /* of the line in work: sums for its yaw error */
    int *touched, n_touched, line;  /* unknowns that the line depends on */
    int *seen_on;                   /* per unknown: last line that depended on it */
} Sums;

/* A reading's ray: its length, unit vector along (azimuth, height), and the patch it falls into. */
typedef struct {
    double range, direction[3];
} Ray;

/* Return the ray to a point from a lidar `ahead` of the yaw axis and `up` above the floor; that it may
 * sit a little to the side is neglected. */
static Ray ray_to(double x, double y, double z, double ahead, double up) {
    double rho = sqrt(x * x + y * y), share = 1 - ahead / (rho > 1e-9 ? rho : 1e-9);
    Ray ray = {0, {share * x, share * y, z - up}};
    double *d = ray.direction, square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
    ray.range = sqrt(square > 1e-18 ? square : 1e-18);
    for (int i = 0; i < 3; i++) d[i] /= ray.range;
    return ray;
}

/* A place on the sphere of directions: its patch, and its position in it, -1 to 1 each way. */
typedef struct {
    int patch;
    double along, upwards;
} Place;

static Place place_of(const Ray *ray) {
    const double *d = ray->direction;
    double column = (angle_of(d[0], d[1]) / TAU + 0.5) * COLUMNS, band = (d[2] + 1) / 2 * BANDS;
    int i = (int)column, j = (int)band;
    i = i < 0 ? 0 : i < COLUMNS ? i : COLUMNS - 1;
    j = j < 0 ? 0 : j < BANDS ? j : BANDS - 1;
    return (Place){i * BANDS + j, 2 * (column - i) - 1, 2 * (band - j) - 1};
}

/* Number the patches that a sample's surfels fall into; return their number. */
static int number_patches(const Sample *sample, const PairNoise *noise, int *row_of) {
    int n = 0;
    for (int k = 0; k < COLUMNS * BANDS; k++) row_of[k] = -1;
    for (int64_t k = 0; k < sample->count; k++) {
        const double *p = sample->rows + SURFEL * sample->chosen[k];
        Ray ray = ray_to(p[X], p[Y], p[Z], noise->ahead, noise->up);
        int patch = place_of(&ray).patch;
        if (row_of[patch] < 0) row_of[patch] = PATCH_ERRORS * n++;
    }
    return n;
}

/* Add a derivative; of the same unknown twice, they add up. */
static void add_derivative(Derivatives *d, int unknown, double by) {
    int k = d->count;
    while (k > 0 && d->unknown[k - 1] > unknown) k--;
    if (k > 0 && d->unknown[k - 1] == unknown) {
        d->by[k - 1] += by;
        return;
    }
    for (int m = d->count++; m > k; m--) d->unknown[m] = d->unknown[m - 1], d->by[m] = d->by[m - 1];
    d->unknown[k] = unknown, d->by[k] = by;
}

/* Add the derivatives of the curve's knots on both sides of a range. */
static void add_knots(Derivatives *d, int first, double range, double by) {
    double at = range / KNOT_SPACING;
    at = at > KNOTS - 1 ? KNOTS - 1 : at;
    int knot = at < KNOTS - 2 ? (int)at : KNOTS - 2;
    add_derivative(d, first + knot, by * (1 - (at - knot)));
    add_derivative(d, first + knot + 1, by * (at - knot));
}

/* Marginalise the yaw error of a line, and begin the sums of the next. */
static void marginalise_yaw(Sums *s, double stride) {
    double share = 1 / (stride + s->square);
    for (int i = 0; i < s->n_touched; i++) {
        int a = s->touched[i];
        s->g[a] -= share * s->h[a] * s->residual;
        for (int k = 0; k < s->n_touched; k++) {
            int b = s->touched[k];
            if (b <= a) s->H[a * s->size + b] -= share * s->h[a] * s->h[b];
        }
    }
    s->n_touched = 0, s->residual = s->square = 0;
}

/* Add a pair of residual e, weight w and error c by the yaw of its line. */
static void add_pair(Sums *s, const Derivatives *d, double e, double w, double c) {
    for (int i = 0; i < d->count; i++) {
        int a = d->unknown[i];
        double weighted = w * d->by[i], *row = s->H + (int64_t)a * s->size;
        s->g[a] += weighted * e;
        for (int k = 0; k <= i; k++) row[d->unknown[k]] += weighted * d->by[k];
        if (s->seen_on[a] != s->line) s->touched[s->n_touched++] = a, s->seen_on[a] = s->line, s->h[a] = 0;
        s->h[a] += weighted * c;
    }
    s->residual += w * c * e;
    s->square += w * c * c;
}

/* Eliminate the unknowns before `state`, first first, by their Schur complements. */
static void eliminate_first(Sums *s, double *column) {
    for (int k = 0; k < s->state; k++) {
        for (int i = k + 1; i < s->size; i++) column[i] = s->H[(int64_t)i * s->size + k];
        double pivot = s->H[(int64_t)k * s->size + k];
        for (int i = k + 1; i < s->size; i++) {
            if (column[i] == 0) continue;
            double share = column[i] / pivot, *row = s->H + (int64_t)i * s->size;
            s->g[i] -= share * s->g[k];
            for (int j = k + 1; j <= i; j++) row[j] -= share * column[j];
        }
    }
}

/* Sum up the pairs of one chunk. */
static void add_chunk(const Target *target, const Sample *sample, int64_t first, int64_t n,
                      const double *T, const int *columns, const PairNoise *noise, const Chunk *w,
                      Sums *s) {
    const double *mount = target->projection.mount;
    for (int64_t k = 0; k < n; k++) {
        if (w->weight[k] == 0) continue;
        if (sample->lines[first + k] != s->line) {
            marginalise_yaw(s, (double)sample->stride);
            s->line = sample->lines[first + k];
        }

        /* incidence on both rays */
        const double normal[3] = {w->J[0][k], w->J[1][k], w->J[2][k]};
        Ray own = ray_to(w->source[X][k], w->source[Y][k], w->source[Z][k], noise->ahead, noise->up);
        Ray other = ray_to(w->target[X][k], w->target[Y][k], w->target[Z][k], mount[5], mount[7]);
        double by_own = 0, by_other = 0;
        for (int i = 0; i < 3; i++) {
            double turned = 0;
            for (int j = 0; j < 3; j++) turned += T[4 * i + j] * own.direction[j];
            by_own += normal[i] * turned, by_other += normal[i] * other.direction[i];
        }

        /* derivatives by patch, pose, yaw scale and curve */
        Place place = place_of(&own);
        Derivatives d = {0};
        int row = s->row_of[place.patch];
        double patch = noise->patch * by_own;
        add_derivative(&d, row, patch);
        add_derivative(&d, row + 1, patch * place.along);
        add_derivative(&d, row + 2, patch * place.upwards);
        for (int i = 0; i <= POSE; i++) add_derivative(&d, s->state + i, w->J[columns[i]][k]);
        add_knots(&d, s->state + POSE + 1, own.range, by_own);
        add_knots(&d, s->state + POSE + 1, other.range, -by_other);
        add_pair(s, &d, w->e[k], w->weight[k], w->line_error[k]);
    }
}

/* Write the inverse of a positive definite matrix (n, n) of rows of `n` numbers, by Gauss and Jordan. */
static void invert_dense(double *M, int n) {
    for (int k = 0; k < n; k++) {
        double pivot = 1 / M[n * k + k];
        for (int j = 0; j < n; j++) M[n * k + j] = j == k ? pivot : M[n * k + j] * pivot;
        for (int i = 0; i < n; i++) {
            if (i == k) continue;
            double share = M[n * i + k];
            M[n * i + k] = 0;
            for (int j = 0; j < n; j++) M[n * i + j] -= share * M[n * k + j];
        }
    }
}

/* Write the columns of the Jacobian in the order of the state: the estimated entries of the pose, the yaw
 * scale, then the entries that a robot on an even floor would not change. */
static void order_columns(const Prior *prior, int *columns) {
    int n = (int)prior->n_entries, next = n + 1;
    columns[n] = POSE;
    for (int entry = 0, k = 0; entry < POSE; entry++) {
        if (k < n && prior->entries[k] == entry) columns[k++] = entry;
        else columns[next++] = entry;
    }
}

/* Add the prior information of the errors that all readings share, besides the yaw scale. */
static void add_shared_prior(const PairNoise *noise, const Prior *prior, Wide *out) {
    /* height and lean on an uneven floor */
    int columns[POSE + 1];
    order_columns(prior, columns);
    for (int i = (int)prior->n_entries + 1; i <= POSE; i++) {
        double sigma = columns[i] == Z ? noise->height : noise->lean;
        out->H[WIDE * i + i] += 1 / (sigma * sigma);
    }

    /* curve of the range error */
    double K[KNOTS * KNOTS], linearity = noise->linearity * noise->linearity;
    for (int i = 0; i < KNOTS; i++)
        for (int j = 0; j < KNOTS; j++) {
            double far = (i - j) * KNOT_SPACING / CURVE_LENGTH;
            K[KNOTS * i + j] = linearity / (1 + far * far / 2) + noise->offset * noise->offset
                             + (i == j ? MIN_CURVE_SIGMA * MIN_CURVE_SIGMA : 0);
        }
    invert_dense(K, KNOTS);
    int first = out->size - KNOTS;
    for (int i = 0; i < KNOTS; i++)
        for (int j = 0; j < KNOTS; j++) out->H[WIDE * (first + i) + first + j] += K[KNOTS * i + j];
}

static void free_sums(Sums *s) {
    free(s->H);
    free(s->touched);
}

/* Return the spread of the patches' mean errors in units of the assumed one, given the step of the state;
 * an estimate that counts the assumption like ASSUMED errors. */
static double measure_patch_spread(const Sums *s, const double *step) {
    double *error = s->h, square = ASSUMED, count = ASSUMED;
    memcpy(error + s->state, step, sizeof *error * (size_t)(s->size - s->state));
    for (int k = s->state - 1; k >= 0; k--) {
        double right = s->g[k], pivot = s->H[(int64_t)k * s->size + k];
        for (int i = k + 1; i < s->size; i++) right += s->H[(int64_t)i * s->size + k] * error[i];
        error[k] = -right / pivot;
        if (k % PATCH_ERRORS == 0) square += error[k] * error[k], count += 1 - 1 / pivot;
    }
    return sqrt(square / count);
}

/* Return the spread of the errors that all readings share, likewise, by the `known` information of the
 * nuisances (after the first `n` entries), their equations, eliminated, and their values; `known` is
 * eliminated, too. */
static double measure_state_spread(Wide *known, const Wide *equations, const double *values, int n) {
    double square = ASSUMED, count = ASSUMED;
    for (int i = n; i < known->size; i++)
        for (int j = n; j < known->size; j++) square += values[i] * known->H[WIDE * i + j] * values[j];
    eliminate_last(known, n);
    for (int k = n; k < known->size; k++)
        count += 1 - known->H[WIDE * k + k] / equations->H[WIDE * k + k];
    return sqrt(square / count);
}

/* Return the noise of pairs whose patches have errors of their own. */
static PairNoise noise_of_readings(const PairNoise *noise) {
    PairNoise single = *noise;
    single.share = 1 / noise->correlation, single.tilt = 0;
    return single;
}

/* Write the normal equations of the whole pose, yaw scale and curve, with the errors of patches, `factor` times as
 * large as assumed, eliminated from the sums. */
static void eliminate_patches(Sums *s, double factor, Wide *out) {
    size_t room = (size_t)s->size;
    memcpy(s->H, s->whole, sizeof *s->H * room * (room + 1));
    for (int k = 0; k < s->state; k++) s->H[(size_t)k * room + (size_t)k] += 1 / (factor * factor) - 1;
    eliminate_first(s, s->h + room);
    out->size = POSE + 1 + KNOTS;
    for (int i = 0; i < out->size; i++) {
        out->g[i] = s->g[s->state + i];
        for (int j = 0; j <= i; j++)
            out->H[WIDE * i + j] = out->H[WIDE * j + i] =
                s->H[(size_t)(s->state + i) * room + (size_t)(s->state + j)];
    }
}

/* Sum up the normal equations of patches, pose, yaw scale and curve, with the lines' errors marginalised, in
 * `sums`, to be freed; also write the pairs and the spurious information to `plain`. Return 0, or -1 if memory
 * runs out. */
static int sum_shared_errors(const Target *target, const Sample *sample, const double *T,
                             const double *nuisances, Gate gate, const PairNoise *noise,
                             const Prior *prior, Chunk *w, Equations *plain, Sums *sums) {
    int columns[POSE + 1], pose = (int)prior->n_entries;
    order_columns(prior, columns);
    Sums s = {.line = -1};
    s.state = PATCH_ERRORS * number_patches(sample, noise, s.row_of);
    s.size = s.state + POSE + 1 + KNOTS;
    size_t room = (size_t)s.size;
    s.H = calloc(room * (2 * room + 4), sizeof *s.H), s.touched = malloc(sizeof *s.touched * 2 * room);
    if (!s.H || !s.touched) {
        free_sums(&s);
        return -1;
    }
    s.g = s.H + room * room, s.h = s.g + room, s.whole = s.h + 2 * room, s.seen_on = s.touched + room;
    for (size_t k = 0; k < room; k++) s.seen_on[k] = -1;
    for (int k = 0; k < s.state; k++) s.H[(size_t)k * room + (size_t)k] = 1;

    /* pairs, without what the patches account for */
    const PairNoise single = noise_of_readings(noise);
    LeverSums swing = {0};
    memset(plain, 0, sizeof *plain);
    plain->size = pose + 1;
    for (int64_t first = 0; first < sample->count; first += CHUNK) {
        int64_t n = sample->count - first < CHUNK ? sample->count - first : CHUNK;
        gather_pairs(target, sample, first, n, T, w);
        linearise_pairs(n, sample->stride, T, nuisances, gate, &single, w, plain);
        clear_rest(n, w);
        add_pairs(n, pose + 1, pose, columns, w, plain);
        sum_levers(n, 0, w, &swing);
        add_chunk(target, sample, first, n, T, columns, noise, w, &s);
    }
    marginalise_yaw(&s, (double)sample->stride);
    add_spurious(&swing, columns, pose, plain);
    mirror(plain->information, plain->size);
    mirror(plain->spurious, pose);

    memcpy(s.whole, s.H, sizeof *s.H * room * (room + 1));
    *sums = s;
    return 0;
}
