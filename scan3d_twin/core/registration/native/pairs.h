/* Correspondences of two sweeps and their normal equations: point_to_plane.py describes the method.
 *
 * Surfels are processed CHUNK at a time, as columns in scratch memory that fits the second-level cache,
 * by loops without branches. */
#pragma once

#include "projection.h"

#define MAX_GATES_ALONG_RAY 3.0 /* distance of a pair's points, in gates; along the normal it is one */
#define MAX_LINE_RATIO 20.0     /* lines of one sweep per line of the other, at grazing incidence */

enum { CHUNK = 256 };

typedef struct {
    double source[SURFEL][CHUNK], source_yaw[CHUNK];
    double elevation[CHUNK], yaw[CHUNK], rate[CHUNK];
    int32_t row[CHUNK];                             /* of the paired surfel of the target, or -1 */
    double target[SURFEL][CHUNK], target_yaw[CHUNK];
    double J[STATE][CHUNK];                         /* derivatives: see point_to_plane.py */
    double e[CHUNK], weight[CHUNK], normal_weight[CHUNK], line_error[CHUNK];
    double a[3][CHUNK];                             /* lever arms */
} Chunk;

/* Copy `n` surfels by their rows to columns, and their yaws; the first surfel where a row is -1. */
static void gather(const double *rows, const double *yaws, const int32_t *chosen, int64_t n,
                   double (*restrict columns)[CHUNK], double *restrict of_columns) {
    for (int64_t k = 0; k < n; k += LANES) {
        Lanes surfels[LANES];
        for (int i = 0; i < LANES; i++) {
            int32_t row = k + i < n && chosen[k + i] > 0 ? chosen[k + i] : 0;
            surfels[i] = load(rows + SURFEL * row);
            of_columns[k + i] = yaws[row];
        }
        transpose(surfels);
        for (int m = 0; m < SURFEL; m++) store(columns[m] + k, surfels[m]);
    }
}

/* Pair each of `n` source points at T with the target's surfel on the reading that sees it, or -1. */
static void associate(const Target *target, int64_t n, const double *T, Chunk *restrict w) {
    const Projection *p = &target->projection;
    const double *restrict xs = w->source[X], *restrict ys = w->source[Y], *restrict zs = w->source[Z];
    double mount[14];
    memcpy(mount, p->mount, sizeof mount);
    const double t0 = T[0], t1 = T[1], t2 = T[2], t3 = T[3], t4 = T[4], t5 = T[5];
    const double t6 = T[6], t7 = T[7], t8 = T[8], t9 = T[9], t10 = T[10], t11 = T[11];
    for (int64_t k = 0; k < n; k++) {
        double x = xs[k], y = ys[k], z = zs[k];
        Direction way = direction_to(t0 * x + t1 * y + t2 * z + t3, t4 * x + t5 * y + t6 * z + t7,
                         t8 * x + t9 * y + t10 * z + t11, AHEAD, mount);
        w->elevation[k] = way.elevation, w->yaw[k] = way.yaw, w->rate[k] = way.rate;
    }

    /* readings ahead of the axis */
    for (int64_t k = 0; k < n; k++) {
        int32_t reading = reading_at(w->elevation[k], w->yaw[k], w->rate[k], p);
        int32_t row = target->index[reading > 0 ? reading : 0];
        w->row[k] = reading >= 0 ? row : -1;
    }

    /* else behind it, if any looks back */
    for (int64_t k = 0; p->backwards && k < n; k++) {
        if (w->row[k] >= 0) continue;
        double x = xs[k], y = ys[k], z = zs[k];
        int32_t reading = reading_of(t0 * x + t1 * y + t2 * z + t3, t4 * x + t5 * y + t6 * z + t7,
                                     t8 * x + t9 * y + t10 * z + t11, BEHIND, p);
        w->row[k] = reading >= 0 ? target->index[reading] : -1;
    }
}

/* Copy a sample's surfels from `first` on, and those of the target that they are paired with at T. */
static void gather_pairs(const Target *target, const Sample *sample, int64_t first, int64_t n, const double *T,
                         Chunk *w) {
    gather(sample->rows, sample->yaws, sample->chosen + first, n, w->source, w->source_yaw);
    associate(target, n, T, w);
    gather(target->rows, target->yaws, w->row, n, w->target, w->target_yaw);
}

/* Write Jacobian, residuals and weights of `n` pairs; the weight of a pair outside the gate is 0. Add the
 * others to the equations' pairs and square. */
static void linearise_pairs(int64_t n, int64_t stride, const double *T, const double *nuisances, Gate gate,
                            const PairNoise *noise, Chunk *restrict w, Equations *sums) {
    const double area = (double)(stride * stride);
    const double c2 = gate.robust * gate.robust, distance = gate.distance;
    const double farthest = MAX_GATES_ALONG_RAY * distance * MAX_GATES_ALONG_RAY * distance;
    const double jitter = noise->jitter, target_jitter = noise->target_jitter;
    const double density = noise->density, whole = noise->share * area, tilt = noise->tilt;
    const double yaw_scale = nuisances[0];
    const double t0 = T[0], t1 = T[1], t2 = T[2], t3 = T[3], t4 = T[4], t5 = T[5];
    const double t6 = T[6], t7 = T[7], t8 = T[8], t9 = T[9], t10 = T[10], t11 = T[11];
    for (int64_t k = 0; k < n; k++) {
        double px = w->source[X][k], py = w->source[Y][k], pz = w->source[Z][k];
        double sx = w->source[NX][k], sy = w->source[NY][k], sz = w->source[NZ][k];
        double qx = w->target[X][k], qy = w->target[Y][k], qz = w->target[Z][k];
        double mx = w->target[NX][k], my = w->target[NY][k], mz = w->target[NZ][k];

        /* lever arm, and mean normal */
        double ax = t0 * px + t1 * py + t2 * pz;
        double ay = t4 * px + t5 * py + t6 * pz;
        double az = t8 * px + t9 * py + t10 * pz;
        double nx = t0 * sx + t1 * sy + t2 * sz;
        double ny = t4 * sx + t5 * sy + t6 * sz;
        double nz = t8 * sx + t9 * sy + t10 * sz;
        double cosine = nx * mx + ny * my + nz * mz;
        nx += mx, ny += my, nz += mz;
        double norm = 1 / sqrt(nx * nx + ny * ny + nz * nz + 1e-18);
        nx *= norm, ny *= norm, nz *= norm;

        /* residual */
        double ux = ax + t3 - qx, uy = ay + t7 - qy, uz = az + t11 - qz;
        double swing = ny * ax - nx * ay, turn = ny * qx - nx * qy;
        double g = w->source_yaw[k] * swing - w->target_yaw[k] * turn;
        double e = nx * ux + ny * uy + nz * uz + g * yaw_scale;

        /* weight */
        double variance = w->source[VARIANCE][k] + w->target[VARIANCE][k];
        double crossing = fabs(nx * ax + ny * ay) * (qx * qx + qy * qy);
        double crossed = fabs(nx * qx + ny * qy) * (ax * ax + ay * ay);
        double lines = density * crossing / (crossed > 1e-9 ? crossed : 1e-9);
        lines = lines < 1 / MAX_LINE_RATIO ? 1 / MAX_LINE_RATIO
              : lines > MAX_LINE_RATIO ? MAX_LINE_RATIO : lines;
        double line_error = sqrt(jitter * swing * swing + target_jitter * lines * turn * turn);
        double robust = c2 / (c2 + e * e / (variance + line_error * line_error));
        int counts = (w->row[k] >= 0) & (cosine > gate.cosine) & (fabs(e) < distance)
                   & (ux * ux + uy * uy + uz * uz < farthest);
        double alike = (cosine - gate.cosine) / (1 - gate.cosine);
        double weight = counts ? whole / variance * robust * robust * alike * alike : 0;

        /* Jacobian */
        w->J[0][k] = nx, w->J[1][k] = ny, w->J[2][k] = nz;
        w->J[3][k] = ay * nz - az * ny, w->J[4][k] = az * nx - ax * nz, w->J[5][k] = swing;
        w->J[6][k] = g;
        w->e[k] = counts ? e : 0, w->weight[k] = weight;
        w->normal_weight[k] =
            weight * ((w->source[NORMAL_VARIANCE][k] + w->target[NORMAL_VARIANCE][k]) / 4 + tilt);
        w->a[0][k] = ax, w->a[1][k] = ay, w->a[2][k] = az;
        w->line_error[k] = swing < 0 ? -line_error : line_error;
    }

    /* inliers and their residuals */
    for (int64_t k = 0; k < n; k++) {
        sums->pairs += w->weight[k] > 0;
        sums->square += w->e[k] * w->e[k];
    }
}

/* Set what lies behind `n` pairs, up to the next whole lane, to 0. */
static void clear_rest(int64_t n, Chunk *w) {
    for (int64_t k = n; k < whole_lanes(n); k++) {
        for (int i = 0; i < STATE; i++) w->J[i][k] = 0;
        w->a[0][k] = w->a[1][k] = w->a[2][k] = w->e[k] = w->weight[k] = w->normal_weight[k] = 0;
    }
}

/* Sums over the pairs of a source line for the marginalisation of its yaw error: see point_to_plane.py. */
typedef struct {
    int32_t line;
    double h[STATE], residual, square;
} LineSums;

/* Marginalise the yaw error of a line, and begin the sums of the next. */
static void marginalise_line(LineSums *line, double stride, Equations *sums) {
    double share = 1 / (stride + line->square);
    for (int i = 0; i < sums->size; i++) {
        sums->gradient[i] -= share * line->h[i] * line->residual;
        for (int k = 0; k <= i; k++) sums->lost[STATE * i + k] += share * line->h[i] * line->h[k];
    }
    *line = (LineSums){.line = line->line};
}

/* Add `n` pairs, sorted by line, to the sums of their lines. */
static void add_line_errors(int64_t n, const int32_t *lines, const int *columns, double stride,
                      const Chunk *w, LineSums *line, Equations *sums) {
    for (int64_t k = 0; k < n; k++) {
        if (w->weight[k] == 0) continue;
        if (lines[k] != line->line) {
            marginalise_line(line, stride, sums);
            line->line = lines[k];
        }
        double weighted = w->weight[k] * w->line_error[k];
        for (int i = 0; i < sums->size; i++) line->h[i] += weighted * w->J[columns[i]][k];
        line->residual += weighted * w->e[k];
        line->square += weighted * w->line_error[k];
    }
}

/* Add `n` pairs to the lower triangles of the sums. Callers pass constants as `size` and `pose`, so that
 * the sums stay in registers. */
static inline __attribute__((always_inline)) void add_pairs(int64_t n, int size, int pose,
                                                            const int *columns, const Chunk *w,
                                                            Equations *sums) {
    Lanes H[STATE][STATE] = {0}, b[STATE] = {0}, S[POSE][POSE] = {0};
    for (int64_t k = 0; k < n; k += LANES) {
        Lanes J[STATE], weight = load(w->weight + k), normal = load(w->normal_weight + k);
        Lanes e = load(w->e + k);
        for (int i = 0; i < size; i++) J[i] = load(w->J[columns[i]] + k);
        for (int i = 0; i < size; i++) {
            Lanes weighted = J[i] * weight;
            b[i] += weighted * e;
            for (int m = 0; m <= i; m++) H[i][m] += weighted * J[m];
        }
        for (int i = 0; i < pose; i++)
            for (int m = 0; m <= i; m++) S[i][m] += J[i] * normal * J[m];
    }
    for (int i = 0; i < size; i++) {
        sums->gradient[i] += total(b[i]);
        for (int m = 0; m <= i; m++) sums->information[STATE * i + m] += total(H[i][m]);
    }
    for (int i = 0; i < pose; i++)
        for (int m = 0; m <= i; m++) sums->spurious[STATE * i + m] -= total(S[i][m]);
}

/* Sums of w nu, w nu a and w nu a a^T over the pairs, with a the lever arm. */
typedef struct {
    double weight, first[3], second[6];
} LeverSums;

/* Add `n` pairs; if `planar`, only what rotations about z need. */
static inline __attribute__((always_inline)) void sum_levers(int64_t n, int planar, const Chunk *w,
                                                            LeverSums *swing) {
    Lanes weight = {0}, first[3] = {0}, second[6] = {0};
    for (int64_t k = 0; k < n; k += LANES) {
        Lanes nu = load(w->normal_weight + k);
        Lanes x = load(w->a[0] + k), y = load(w->a[1] + k), nx = nu * x, ny = nu * y;
        weight += nu, first[0] += nx, first[1] += ny, second[0] += nx * x, second[2] += ny * y;
        if (planar) continue;
        Lanes z = load(w->a[2] + k);
        first[2] += nu * z;
        second[1] += nx * y, second[3] += nx * z, second[4] += ny * z, second[5] += nu * z * z;
    }
    swing->weight += total(weight);
    for (int i = 0; i < 3; i++) swing->first[i] += total(first[i]);
    for (int i = 0; i < 6; i++) swing->second[i] += total(second[i]);
}

/* Add sum w nu B B^T to the spurious information: B = (I, [a]x). */
static void add_spurious(const LeverSums *swing, const int *columns, int pose, Equations *sums) {
    double W = swing->weight, x = swing->first[0], y = swing->first[1], z = swing->first[2];
    const double *s = swing->second;
    const double trace = s[0] + s[2] + s[5];
    const double full[POSE][POSE] = {
        {W}, {0, W}, {0, 0, W},
        {0, -z, y, trace - s[0]},
        {z, 0, -x, -s[1], trace - s[2]},
        {-y, x, 0, -s[3], -s[4], s[0] + s[2]},
    };
    for (int i = 0; i < pose; i++)
        for (int m = 0; m <= i; m++)
            sums->spurious[STATE * i + m] += full[columns[i]][columns[m]];
}

/* Copy the lower triangle of a matrix to the upper. */
static void mirror(double *M, int64_t size) {
    for (int i = 0; i < size; i++)
        for (int m = 0; m < i; m++) M[STATE * m + i] = M[STATE * i + m];
}

/* Write the normal equations of a sample at T for the prior's entries and nuisances. */
static void build_equations(const Target *target, const Sample *sample, const double *T,
                            const double *nuisances, Gate gate, const PairNoise *noise,
                            const Prior *prior, Chunk *w, Equations *sums) {
    const int jittery = noise->jitter > 0 || noise->target_jitter > 0;
    const double stride = (double)sample->stride;
    int columns[STATE], pose = (int)prior->n_entries, size = pose + (int)prior->n_nuisances;
    for (int i = 0; i < size; i++) columns[i] = i < pose ? (int)prior->entries[i] : POSE + i - pose;
    LineSums line = {.line = -1};
    LeverSums swing = {0};
    memset(sums, 0, sizeof *sums);
    sums->size = size;

    for (int64_t first = 0; first < sample->count; first += CHUNK) {
        int64_t n = sample->count - first < CHUNK ? sample->count - first : CHUNK;

        /* correspondences, residuals and weights */
        gather_pairs(target, sample, first, n, T, w);
        linearise_pairs(n, sample->stride, T, nuisances, gate, noise, w, sums);
        clear_rest(n, w);

        /* sums */
        if (jittery) add_line_errors(n, sample->lines + first, columns, stride, w, &line, sums);
        if (size == 4 && pose == 3 && columns[2] == 5) {
            add_pairs(n, 4, 3, columns, w, sums);
            sum_levers(n, 1, w, &swing);
        } else {
            add_pairs(n, size, pose, columns, w, sums);
            sum_levers(n, 0, w, &swing);
        }
    }

    /* last line, noise of normals, upper triangles */
    marginalise_line(&line, stride, sums);
    add_spurious(&swing, columns, pose, sums);
    mirror(sums->information, size);
    mirror(sums->lost, size);
    mirror(sums->spurious, pose);
}

/* Add information (6, 6) and gradient (6,) of the edges at T: edges.py describes the method. */
static void linearise_edges(const double *target, int64_t n_target, const double *source, int64_t n_source,
                      const double *T, double distance, double robust, double *H, double *g) {
    const double c2 = robust * robust;
    for (int64_t i = 0; i < n_source; i++) {
        const double *s = source + EDGE * i, *nearest = NULL;
        double x = T[0] * s[PLACE_X] + T[1] * s[PLACE_Y], y = T[4] * s[PLACE_X] + T[5] * s[PLACE_Y];
        double best = distance * distance;

        /* nearest edge of the same side and height */
        for (int64_t k = 0; k < n_target; k++) {
            const double *q = target + EDGE * k;
            double high = s[HIGH] < q[HIGH] ? s[HIGH] : q[HIGH], low = s[LOW] > q[LOW] ? s[LOW] : q[LOW];
            if (s[SIDE] != q[SIDE] || high <= low) continue;
            double dx = x + T[3] - q[PLACE_X], dy = y + T[7] - q[PLACE_Y], far = dx * dx + dy * dy;
            if (far < best) nearest = q, best = far;
        }
        if (!nearest) continue;

        /* residual across the ray, weighted */
        double nx = nearest[ACROSS_X], ny = nearest[ACROSS_Y];
        double e = nx * (x + T[3] - nearest[PLACE_X]) + ny * (y + T[7] - nearest[PLACE_Y]);
        double variance = s[EDGE_VARIANCE] + nearest[EDGE_VARIANCE];
        double share = c2 / (c2 + e * e / variance), weight = share * share / variance;
        const double J[POSE] = {nx, ny, 0, 0, 0, ny * x - nx * y};
        for (int a = 0; a < POSE; a++) {
            g[a] += weight * J[a] * e;
            for (int b = 0; b < POSE; b++) H[POSE * a + b] += weight * J[a] * J[b];
        }
    }
}
