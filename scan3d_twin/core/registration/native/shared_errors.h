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
    OWN = POSE + 1,             /* unknowns of the state before the knots */
    MAX_KNOTS = 4,              /* knots on which a residual depends */
};

/* Derivatives of a residual by the curve's knots, ascending. */
typedef struct {
    int count, knot[MAX_KNOTS];
    double by[MAX_KNOTS];
} KnotDerivatives;

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

/* Rays to the points of a chunk: their lengths, and unit vectors along (azimuth, height). */
typedef struct {
    double range[CHUNK], direction[3][CHUNK];
} Rays;

/* Write the rays to `n` points from a lidar `ahead` of the yaw axis and `up` above the floor; that it may
 * sit a little to the side is neglected. */
static void measure_rays(const double (*restrict points)[CHUNK], int64_t n, double ahead, double up,
                         Rays *restrict rays) {
    for (int64_t k = 0; k < n; k++) {
        double x = points[X][k], y = points[Y][k];
        double rho = sqrt(x * x + y * y), share = 1 - ahead / (rho > 1e-9 ? rho : 1e-9);
        double dx = share * x, dy = share * y, dz = points[Z][k] - up;
        double square = dx * dx + dy * dy + dz * dz;
        double range = sqrt(square > 1e-18 ? square : 1e-18);
        rays->range[k] = range;
        rays->direction[0][k] = dx / range, rays->direction[1][k] = dy / range;
        rays->direction[2][k] = dz / range;
    }
}

/* Points of the source's rays on which both readings of a pair agree best: relative to the source's origin, and
 * in the target's frame; the cosines of incidence of these rays, and the yaws at which the target sees the points. */
typedef struct {
    double lever[3][CHUNK], point[3][CHUNK], by_own[CHUNK], target_yaw[CHUNK];
} Agreed;

/* Find the points on which the readings of `n` pairs agree, and set the ranges of the source's rays to them. */
static void find_agreed_points(const double *T, int64_t n, const Chunk *w, Rays *restrict own,
                               Agreed *restrict out) {
    for (int64_t k = 0; k < n; k++) {
        double ray[3], by_own = 0;
        for (int i = 0; i < 3; i++) {
            ray[i] = T[4 * i] * own->direction[0][k] + T[4 * i + 1] * own->direction[1][k]
                   + T[4 * i + 2] * own->direction[2][k];
            by_own += w->J[i][k] * ray[i];
        }

        /* share the residual by the variances */
        double share = w->source[VARIANCE][k] / (w->source[VARIANCE][k] + w->target[VARIANCE][k]);
        double cosine = fabs(by_own) > MIN_COSINE ? by_own : copysign(MIN_COSINE, by_own);
        double farther = -share * w->e[k] / cosine;
        for (int i = 0; i < 3; i++) {
            out->lever[i][k] = w->a[i][k] + farther * ray[i];
            out->point[i][k] = out->lever[i][k] + T[4 * i + 3];
        }
        own->range[k] += farther;
        out->by_own[k] = by_own;

        /* turn on from the target's reading */
        double x = w->target[X][k], y = w->target[Y][k];
        out->target_yaw[k] = w->target_yaw[k] + (x * out->point[Y][k] - y * out->point[X][k]) / (x * x + y * y);
    }
}

/* Places of rays on the sphere of directions: their patches, and positions in them, -1 to 1 each way. */
typedef struct {
    int32_t patch[CHUNK];
    double along[CHUNK], upwards[CHUNK];
} Places;

static void locate_rays(const Rays *restrict rays, int64_t n, Places *restrict places) {
    for (int64_t k = 0; k < n; k++) {
        double azimuth = angle_of(rays->direction[0][k], rays->direction[1][k]);
        double column = (azimuth / TAU + 0.5) * COLUMNS, band = (rays->direction[2][k] + 1) / 2 * BANDS;
        int32_t i = (int32_t)column, j = (int32_t)band;
        i = i < 0 ? 0 : i < COLUMNS ? i : COLUMNS - 1;
        j = j < 0 ? 0 : j < BANDS ? j : BANDS - 1;
        places->patch[k] = i * BANDS + j;
        places->along[k] = 2 * (column - i) - 1, places->upwards[k] = 2 * (band - j) - 1;
    }
}

/* Number the patches that a sample's surfels fall into; return their number. */
static int number_patches(const Sample *sample, const PairNoise *noise, Chunk *w, int *row_of) {
    int count = 0;
    Rays rays;
    Places places;
    for (int k = 0; k < COLUMNS * BANDS; k++) row_of[k] = -1;
    for (int64_t first = 0; first < sample->count; first += CHUNK) {
        int64_t n = sample->count - first < CHUNK ? sample->count - first : CHUNK;
        gather(sample->rows, sample->yaws, sample->chosen + first, n, w->source, w->source_yaw);
        measure_rays(w->source, n, noise->ahead, noise->up, &rays);
        locate_rays(&rays, n, &places);
        for (int64_t k = 0; k < n; k++)
            if (row_of[places.patch[k]] < 0) row_of[places.patch[k]] = PATCH_ERRORS * count++;
    }
    return count;
}

/* Add a derivative; of the same knot twice, they add up. */
static void add_derivative(KnotDerivatives *d, int knot, double by) {
    int k = d->count;
    while (k > 0 && d->knot[k - 1] > knot) k--;
    if (k > 0 && d->knot[k - 1] == knot) {
        d->by[k - 1] += by;
        return;
    }
    for (int m = d->count++; m > k; m--) d->knot[m] = d->knot[m - 1], d->by[m] = d->by[m - 1];
    d->knot[k] = knot, d->by[k] = by;
}

/* Add the derivatives of the curve's knots on both sides of a range. */
static void add_knots(KnotDerivatives *d, double range, double by) {
    double at = range > 0 ? range / KNOT_SPACING : 0;
    at = at > KNOTS - 1 ? KNOTS - 1 : at;
    int knot = at < KNOTS - 2 ? (int)at : KNOTS - 2;
    add_derivative(d, knot, by * (1 - (at - knot)));
    add_derivative(d, knot + 1, by * (at - knot));
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

/* Begin the sums for the yaw error of the line in work of `n` unknowns from `first` on, all or none of which
 * it depends on so far. */
static void touch(Sums *s, int first, int n) {
    if (s->seen_on[first] == s->line) return;
    s->seen_on[first] = s->line;
    for (int a = first; a < first + n; a++) s->touched[s->n_touched++] = a, s->h[a] = 0;
}

/* A pair: residual, weight, error by the yaw of its line, and the residual's derivatives by the errors of the
 * patch in row `patch`, by the state before the knots, followed by 0, and by the knots. */
typedef struct {
    double e, w, c, by_patch[PATCH_ERRORS];
    Lanes by_state;
    int patch;
    KnotDerivatives knots;
} Pair;

/* Add a pair to the row of an unknown by which the residual has the derivative `by`, in the columns of the
 * patch and of the state before the knots. Columns beyond the diagonal are never read. */
static inline void add_row(Sums *s, const Pair *pair, int unknown, double by) {
    double weighted = pair->w * by, *row = s->H + (int64_t)unknown * s->size;
    double *patch = row + pair->patch, *state = row + s->state;
    s->g[unknown] += weighted * pair->e, s->h[unknown] += weighted * pair->c;
    for (int k = 0; k < PATCH_ERRORS; k++) patch[k] += weighted * pair->by_patch[k];
    store(state, load(state) + weighted * pair->by_state);
}

static void add_pair(Sums *s, const Pair *pair) {
    _Static_assert(OWN < LANES && PATCH_ERRORS + OWN + KNOTS > LANES, "rows have room for lanes");
    const int first = s->state + OWN;

    /* begin the sums of the line's yaw error */
    touch(s, pair->patch, PATCH_ERRORS);
    touch(s, s->state, OWN);
    for (int k = 0; k < pair->knots.count; k++) touch(s, first + pair->knots.knot[k], 1);
    s->residual += pair->w * pair->c * pair->e;
    s->square += pair->w * pair->c * pair->c;

    /* rows of patch, state and knots */
    for (int i = 0; i < PATCH_ERRORS; i++) {
        int a = pair->patch + i;
        double weighted = pair->w * pair->by_patch[i], *row = s->H + (int64_t)a * s->size + pair->patch;
        s->g[a] += weighted * pair->e, s->h[a] += weighted * pair->c;
        for (int k = 0; k <= i; k++) row[k] += weighted * pair->by_patch[k];
    }
    for (int i = 0; i < OWN; i++) add_row(s, pair, s->state + i, pair->by_state[i]);
    for (int i = 0; i < pair->knots.count; i++) {
        int a = first + pair->knots.knot[i];
        double weighted = pair->w * pair->knots.by[i], *row = s->H + (int64_t)a * s->size + first;
        add_row(s, pair, a, pair->knots.by[i]);
        for (int k = 0; k <= i; k++) row[pair->knots.knot[k]] += weighted * pair->knots.by[k];
    }
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
    Rays own, other;
    Places places;
    Agreed at;
    measure_rays(w->source, n, noise->ahead, noise->up, &own);
    locate_rays(&own, n, &places);
    find_agreed_points(T, n, w, &own, &at);
    measure_rays(at.point, n, mount[5], mount[7], &other);
    for (int64_t k = 0; k < n; k++) {
        if (w->weight[k] == 0) continue;
        if (sample->lines[first + k] != s->line) {
            marginalise_yaw(s, (double)sample->stride);
            s->line = sample->lines[first + k];
        }

        /* derivatives by pose and yaw scale */
        double nx = w->J[0][k], ny = w->J[1][k], nz = w->J[2][k];
        double ax = at.lever[X][k], ay = at.lever[Y][k], az = at.lever[Z][k];
        double swing = ny * ax - nx * ay, turn = ny * at.point[X][k] - nx * at.point[Y][k];
        const double J[OWN] = {nx, ny, nz, ay * nz - az * ny, az * nx - ax * nz, swing,
                               w->source_yaw[k] * swing - at.target_yaw[k] * turn};

        /* derivatives by patch and curve */
        double patch = noise->patch * at.by_own[k];
        double by_other = nx * other.direction[0][k] + ny * other.direction[1][k] + nz * other.direction[2][k];
        Pair pair = {.e = w->e[k], .w = w->weight[k], .c = w->line_error[k],
                     .by_patch = {patch, patch * places.along[k], patch * places.upwards[k]},
                     .patch = s->row_of[places.patch[k]]};
        for (int i = 0; i < OWN; i++) pair.by_state[i] = J[columns[i]];
        add_knots(&pair.knots, own.range[k], at.by_own[k]);
        add_knots(&pair.knots, other.range[k], -by_other);
        add_pair(s, &pair);
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
    int columns[OWN];
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
    out->size = OWN + KNOTS;
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
    int columns[OWN], pose = (int)prior->n_entries;
    order_columns(prior, columns);
    Sums s = {.line = -1};
    s.state = PATCH_ERRORS * number_patches(sample, noise, w, s.row_of);
    s.size = s.state + OWN + KNOTS;
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
