/* Surfels of a sweep, by plane fits over windows: surfels/extraction.py describes the method.
 *
 * Only the rows in use of the summed-area table are kept. The beams of a line are processed BLOCK at a
 * time, by loops without branches; a block is finished when all its readings have a surfel. */
#pragma once

#include "angles.h"
#include "engine.h"
#include "lanes.h"
#include <stdlib.h>

#define MIN_FILLED_SHARE 0.6    /* share of a window's readings that a fit needs */
#define MAX_TILT 0.25           /* standard deviation of a normal [rad]: with more it tells nothing */
#define MAX_RSS_SIGMAS 0.7      /* residual sum of squares of a fit, in sigma above that of noise alone */
#define LIMB_COSINE 0.5         /* of incidence (60 deg): a surface seen flatter may be the limb of a round body */
#define MAX_OFF_CENTRE 1.01    /* squared distance of a reading from its window's middle, in variances of the
                                 * window along it: up to half the way to the window's end. Many
                                 * readings are exactly there; rounding must not decide on them */
#define MIN_COSINE 0.05         /* of incidence: a plane seen flatter (87 deg) is not trusted */

enum {
    MOMENTS = 11,
    PRODUCTS = 9,       /* the first of them: x x^T and x q */
    BLOCK = 2 * LANES,
};

/* Adjacent beams of a line that are fitted together, from `first` on. */
typedef struct {
    double ray[3][BLOCK], eye[2][BLOCK], inverse_range[BLOCK], sigma[BLOCK];
    double open[BLOCK];             /* 1 where a surfel is wanted but no plane has fitted yet */
    double found[SURFEL][BLOCK];    /* the surfels */
    int64_t first;
} __attribute__((aligned(64))) Block;

/* Windows around a reading: half their size in lines and in beams, largest first. */
typedef struct {
    int64_t count;
    const int64_t (*half)[2];
} Windows;

/* Write cosines (n,), then sines (n,) of the yaws of a line. */
static void turn_line(const double *restrict yaws, int64_t n, double *restrict turns) {
    Turn first = turn_by(yaws[0]);
    int64_t wide = 0;
    for (int64_t j = 0; j < n; j++) wide += fabs(yaws[j] - yaws[0]) > SMALL_TURN;
    for (int64_t j = 0; wide == 0 && j < n; j++) {
        Turn turn = turn_further(first, yaws[j] - yaws[0]);
        turns[j] = turn.c, turns[n + j] = turn.s;
    }
    for (int64_t j = 0; wide > 0 && j < n; j++) {
        Turn turn = turn_by(yaws[j]);
        turns[j] = turn.c, turns[n + j] = turn.s;
    }
}

/* Write the row of the summed-area table below `above` that adds a line; rows have `margin` + 1 columns
 * before the first beam and `margin` after the last. */
static void add_line(const Sweep *sweep, int64_t line, const uint8_t *valid, const double *turns,
                     int64_t margin, int64_t width, const double *restrict above,
                     double *restrict below) {
    const double *ranges = sweep->ranges + line * sweep->stride;
    const double *rays = sweep->rays + line * sweep->ray_stride;
    double sum[MOMENTS] = {0};
    int64_t n_beams = sweep->n_beams, first = 0, end = n_beams;
    while (first < end && !valid[first]) first++;
    while (end > first && !valid[end - 1]) end--;

    /* unchanged before the first reading */
    for (int m = 0; m < MOMENTS; m++)
        memcpy(below + m * width, above + m * width, sizeof *below * (size_t)(margin + 1 + first));

    /* add moments of each reading */
    for (int64_t j = first; j < end; j++) {
        if (valid[j]) {
            double q = 1 / ranges[j], c = turns[j], s = turns[n_beams + j];
            double ahead = rays[3 * j] + q * sweep->lever[0];
            double left = rays[3 * j + 1] + q * sweep->lever[1];
            double x = c * ahead - s * left, y = s * ahead + c * left;
            double z = rays[3 * j + 2];
            const double moments[MOMENTS] = {x * x, x * y, x * z, y * y, y * z, z * z,
                                             x * q, y * q, z * q, q * q, 1};
            for (int m = 0; m < MOMENTS; m++) sum[m] += moments[m];
        }
        int64_t at = margin + 1 + j;
        for (int m = 0; m < MOMENTS; m++) below[m * width + at] = above[m * width + at] + sum[m];
    }

    /* constant after the last */
    for (int m = 0; m < MOMENTS; m++)
        for (int64_t at = margin + 1 + end; at < width; at++)
            below[m * width + at] = above[m * width + at] + sum[m];
}

/* Read ray, position of the lidar, inverse range and noise of the first `n` beams of a block. Callers pass
 * a constant `n` for full blocks, so that the loop has no remainder. */
static inline __attribute__((always_inline)) void read_beams(const Sweep *sweep, int64_t line,
                                                             const double *restrict turns,
                                                             const double noise[2], int64_t n,
                                                             Block *restrict w) {
    const int64_t at = line * sweep->stride + w->first;
    const double *restrict ranges = sweep->ranges + at;
    const double *restrict rays = sweep->rays + line * sweep->ray_stride + 3 * w->first;
    const double *restrict cosines = turns + w->first, *restrict sines = cosines + sweep->n_beams;
    const double ahead = sweep->lever[0], left = sweep->lever[1];
    const double at_zero = noise[0], growth = noise[1];
    for (int64_t k = 0; k < n; k++) {
        double c = cosines[k], s = sines[k];
        w->ray[0][k] = c * rays[3 * k] - s * rays[3 * k + 1];
        w->ray[1][k] = s * rays[3 * k] + c * rays[3 * k + 1];
        w->ray[2][k] = rays[3 * k + 2];
        w->eye[0][k] = c * ahead - s * left;
        w->eye[1][k] = s * ahead + c * left;
        w->inverse_range[k] = 1 / ranges[k];
        w->sigma[k] = at_zero + growth * ranges[k];
    }
    if (sweep->sigmas) memcpy(w->sigma, sweep->sigmas + at, sizeof *w->sigma * (size_t)n);
}

static double sum_block(const double values[BLOCK]) { return total(load(values) + load(values + LANES)); }

/* Read the beams of a line from `first` on, as far as it goes; return whether one wants a surfel. */
static int read_block(const Sweep *sweep, int64_t line, const uint8_t *wanted, const double *turns,
                      const double noise[2], int64_t first, Block *w) {
    int64_t n = sweep->n_beams - first;
    for (int64_t k = 0; k < BLOCK; k++) w->open[k] = k < n && wanted[first + k];
    w->first = first;
    if (!(sum_block(w->open) > 0)) return 0;
    if (n >= BLOCK) read_beams(sweep, line, turns, noise, BLOCK, w);
    else read_beams(sweep, line, turns, noise, n, w);
    return 1;
}

/* Two rows of the summed-area table, and the lines between them. */
typedef struct {
    const double *above, *below;    /* rows of the table (MOMENTS, width) */
    int64_t margin, width;          /* columns before the first beam less one, and in all */
    int64_t lines, n_beams;
} Strip;

/* Write the first `count` moments of windows of `half` beams to either side. */
static inline __attribute__((always_inline)) void sum_windows(const Strip *strip, int64_t half, int64_t first,
                                                              int count, double (*restrict moments)[BLOCK]) {
    const int64_t left = strip->margin + first - half, right = left + 2 * half + 1;
    for (int m = 0; m < count; m++) {
        const double *above = strip->above + m * strip->width, *below = strip->below + m * strip->width;
        for (int64_t k = 0; k < BLOCK; k++)
            moments[m][k] = (below[right + k] - above[right + k]) - (below[left + k] - above[left + k]);
    }
}

/* The windows inside others, by whose readings the surface is found to be curved. */
typedef struct {
    const Strip *strip;
    int64_t half;
    double gain;        /* see find_gain */
} Inner;

/* Move surfels of planes along their rays onto a curved surface: by the distance of the inner windows from
 * these planes, as far as it exceeds its noise. `moments` are those of the planes' windows, of `lines` lines. */
static void follow_curvature(const Inner *inner, const double (*restrict moments)[BLOCK], double lines,
                             double height, double yaw_variance, double correlation,
                             const Block *restrict w, double (*restrict made)[BLOCK]) {
    const double by_lines = yaw_variance * (1 / (double)inner->strip->lines - 1 / lines);
    double near[PRODUCTS][BLOCK];
    sum_windows(inner->strip, inner->half, w->first, PRODUCTS, near);
    for (int64_t k = 0; k < BLOCK; k++) {
        double xx = near[0][k], xy = near[1][k], xz = near[2][k];
        double yy = near[3][k], yz = near[4][k], zz = near[5][k];
        double nx = made[NX][k], ny = made[NY][k], nz = made[NZ][k], q = w->inverse_range[k];
        double x = made[X][k], y = made[Y][k], distance = nx * x + ny * y + nz * (made[Z][k] - height);

        /* the parallel plane through the inner window, and its noise */
        double by_near = (near[6][k] * nx + near[7][k] * ny + near[8][k] * nz) * distance;
        double of_near = nx * (xx * nx + 2 * (xy * ny + xz * nz)) + ny * (yy * ny + 2 * yz * nz) + zz * nz * nz;
        double of_all = (moments[6][k] * nx + moments[7][k] * ny + moments[8][k] * nz) * distance;
        double per_near = 1 / of_near, off = by_near * per_near - 1, swing = (ny * x - nx * y) / distance;
        double noise = q * q * made[VARIANCE][k] * correlation * (per_near - 1 / of_all) + swing * swing * by_lines;

        /* what exceeds the noise, along the ray */
        double share = off * off > noise ? 1 - noise / (off * off) : 0;
        double onto = nx * w->ray[0][k] + ny * w->ray[1][k] + nz * w->ray[2][k];
        double bent = inner->gain * share * off, farther = -distance * bent / ((1 + bent) * onto);
        made[X][k] += farther * w->ray[0][k], made[Y][k] += farther * w->ray[1][k];
        made[Z][k] += farther * w->ray[2][k];
    }
}

/* Take none of the planes on what may be a `limb` unless the reading is near the middle of its window, whose
 * points count by q^2; `made` are relative to the lidar's height. */
static void drop_limbs(const double (*restrict moments)[BLOCK], const double (*restrict made)[BLOCK],
                       const double *restrict limb, double *restrict taken) {
    for (int64_t k = 0; k < BLOCK; k++) {
        double xx = moments[0][k], xy = moments[1][k], xz = moments[2][k];
        double yy = moments[3][k], yz = moments[4][k], zz = moments[5][k], qq = moments[9][k];
        double gx = moments[6][k] / qq, gy = moments[7][k] / qq, gz = moments[8][k] / qq;
        double ux = gx - made[X][k], uy = gy - made[Y][k], uz = gz - made[Z][k];
        double off = ux * ux + uy * uy + uz * uz, at_middle = ux * gx + uy * gy + uz * gz;
        double second = ux * (xx * ux + 2 * (xy * uy + xz * uz)) + uy * (yy * uy + 2 * yz * uz)
                      + zz * uz * uz;
        int central = off * off <= MAX_OFF_CENTRE * (second / qq - at_middle * at_middle);
        taken[k] = limb[k] > 0 && !central ? 0 : taken[k];
    }
}

/* Fit planes to windows of `half` beams to either side and keep those that fit for open readings; return
 * whether any stays open. */
static int fit_planes(const Strip *strip, int64_t half, const Inner *inner, double height,
                          double yaw_variance, double correlation, Block *restrict w) {
    const double lines = (double)strip->lines, per_lines = 1 / lines;
    const double most_by_yaw = 1 + MAX_RSS_SIGMAS * sqrt(2 * per_lines);
    double moments[MOMENTS][BLOCK], area[BLOCK], made[SURFEL][BLOCK], taken[BLOCK], limb[BLOCK];

    /* sums over the windows, and their size */
    sum_windows(strip, half, w->first, MOMENTS, moments);
    for (int64_t k = 0; k < BLOCK; k++) {
        int64_t j = w->first + k, low = j > half ? j - half : 0;
        int64_t high = j + half + 1 < strip->n_beams ? j + half + 1 : strip->n_beams;
        area[k] = (double)(strip->lines * (high - low));
    }
    for (int64_t k = 0; k < BLOCK; k++) {
        double xx = moments[0][k], xy = moments[1][k], xz = moments[2][k];
        double yy = moments[3][k], yz = moments[4][k], zz = moments[5][k];
        double bx = moments[6][k], by = moments[7][k], bz = moments[8][k];
        double qq = moments[9][k], readings = moments[10][k];
        double dx = w->ray[0][k], dy = w->ray[1][k], dz = w->ray[2][k];
        double ox = w->eye[0][k], oy = w->eye[1][k];
        double q = w->inverse_range[k], sigma = w->sigma[k];

        /* m = A^-1 b by cofactors */
        double c_xx = yy * zz - yz * yz, c_xy = xz * yz - xy * zz, c_xz = xy * yz - xz * yy;
        double c_yy = xx * zz - xz * xz, c_yz = xy * xz - xx * yz, c_zz = xx * yy - xy * xy;
        double det = xx * c_xx + xy * c_xy + xz * c_xz, trace = xx + yy + zz, inverse = 1 / det;
        double mx = (c_xx * bx + c_xy * by + c_xz * bz) * inverse;
        double my = (c_xy * bx + c_yy * by + c_yz * bz) * inverse;
        double mz = (c_xz * bx + c_yz * by + c_zz * bz) * inverse;

        /* point on the ray, and noise along the normal; the plane is relative to the lidar's height */
        double along = mx * dx + my * dy + mz * dz, square = mx * mx + my * my + mz * mz;
        double r = (1 - (mx * ox + my * oy)) / along;
        double x = ox + r * dx, y = oy + r * dy, z = r * dz;
        double by_range = along * along * sigma * sigma, scatter = q * q * by_range;

        /* does the plane fit? */
        double rss = qq - mx * bx - my * by - mz * bz, swing = my * x - mx * y;
        double by_yaw = readings * q * q * swing * swing * yaw_variance;
        double free = readings - 3 > 1 ? readings - 3 : 1;
        double most = scatter * (free + MAX_RSS_SIGMAS * sqrt(2 * free)) + by_yaw * most_by_yaw;

        /* noise of the normal */
        double per_square = 1 / square;
        double onto = mx * (c_xx * mx + 2 * (c_xy * my + c_xz * mz)) + my * (c_yy * my + 2 * c_yz * mz)
                    + c_zz * mz * mz;
        double tangents = (c_xx + c_yy + c_zz - onto * per_square) * inverse;
        double tilt = tangents * (scatter * correlation + by_yaw * per_lines) * per_square / 2;

        /* take it? */
        int fits = (w->open[k] > 0) & (readings >= MIN_FILLED_SHARE * area[k]) & (readings > 5)
                 & (r > 0) & (rss <= most) & (det > 1e-12 * trace * trace * trace)
                 & (along * along > MIN_COSINE * MIN_COSINE * square) & (tilt < MAX_TILT * MAX_TILT);
        double towards = (along > 0 ? -1 : 1) * sqrt(per_square);
        made[X][k] = x, made[Y][k] = y, made[Z][k] = z;
        made[NX][k] = towards * mx, made[NY][k] = towards * my, made[NZ][k] = towards * mz;
        made[VARIANCE][k] = by_range * per_square;
        made[NORMAL_VARIANCE][k] = tilt;
        taken[k] = fits ? 1 : 0;
        limb[k] = fits & !(along * along > LIMB_COSINE * LIMB_COSINE * square) ? 1 : 0;
    }
    if (sum_block(limb) > 0) drop_limbs(moments, made, limb, taken);

    /* keep the planes that fit, on the surface */
    for (int64_t k = 0; k < BLOCK; k++) w->open[k] -= taken[k], made[Z][k] += height;
    if (sum_block(taken) > 0 && inner->gain > 0)
        follow_curvature(inner, moments, lines, height, yaw_variance, correlation, w, made);
    for (int m = 0; m < SURFEL; m++)
        for (int64_t k = 0; k < BLOCK; k++)
            w->found[m][k] = taken[k] > 0 ? made[m][k] : w->found[m][k];
    return sum_block(w->open) > 0;
}

/* Return the distance of a window's plane from the middle of a paraboloid over its distance from the readings of
 * the window inside; 0 if both are as large. n readings in a row have the variance (n^2 - 1) / 12. */
static double find_gain(const int64_t outer[2], const int64_t inner[2]) {
    double ratio = 0;
    for (int i = 0; i < 2; i++)
        ratio += (double)(inner[i] * (inner[i] + 1)) / (double)(outer[i] * (outer[i] + 1)) / 2;
    return ratio < 1 ? 1 / (1 - ratio) : 0;
}

/* Append the surfels of the wanted readings that are no longer open, and their yaws; return the new
 * number of surfels. */
static int64_t append_surfels(const Block *w, const uint8_t *wanted, const double *yaws, int64_t n_beams,
                              int64_t count, double *rows, double *of_rows, int32_t *index) {
    for (int64_t k = 0; k < BLOCK; k += LANES) {
        Lanes surfels[LANES];
        for (int m = 0; m < SURFEL; m++) surfels[m] = load(w->found[m] + k);
        transpose(surfels);
        for (int64_t i = 0, j = w->first + k; i < LANES && j < n_beams; i++, j++) {
            if (!wanted[j] || w->open[k + i] > 0) continue;
            store(rows + SURFEL * count, surfels[i]);
            of_rows[count] = yaws[j], index[j] = (int32_t)count++;
        }
    }
    return count;
}

/* Return the part of a sweep up to the last windows around readings to `keep`: no sum needs the rest. */
static Sweep crop_to_windows(const Sweep *sweep, const uint8_t *keep, int64_t tallest, int64_t widest) {
    int64_t lines = 0, beams = 0;
    for (int64_t i = 0; i < sweep->n_lines; i++) {
        int64_t end = sweep->n_beams;
        while (end > beams && !keep[i * sweep->stride + end - 1]) end--;
        beams = end > beams ? end : beams;
        if (memchr(keep + i * sweep->stride, 1, (size_t)beams)) lines = i + 1;
    }
    Sweep part = *sweep;
    part.n_lines = lines + tallest < part.n_lines ? lines + tallest : part.n_lines;
    part.n_beams = beams + widest < part.n_beams ? beams + widest : part.n_beams;
    return part;
}

/* Write the surfels of the readings to `keep`; return their number, or -1 if memory runs out. `index` is
 * written only where there is a surfel. */
static int64_t fit_surfels(const Sweep *sweep, const uint8_t *valid, const uint8_t *keep,
                           const double noise[NOISES], Windows windows, double *rows, double *of_rows,
                           int32_t *index) {
    int64_t tallest = 0, margin = 0, count = 0, summed = 0;

    /* size of the table in use */
    for (int64_t k = 0; k < windows.count; k++) {
        tallest = windows.half[k][0] > tallest ? windows.half[k][0] : tallest;
        margin = windows.half[k][1] > margin ? windows.half[k][1] : margin;
    }
    const Sweep needed = crop_to_windows(sweep, keep, tallest, margin);
    int64_t n_lines = needed.n_lines, n_beams = needed.n_beams, stride = sweep->stride;
    int64_t depth = 2 * tallest + 2, width = n_beams + 1 + 2 * margin + BLOCK, row = MOMENTS * width;
    double *sums = malloc(sizeof *sums * (size_t)(depth * row));
    double *turns = malloc(sizeof *turns * (size_t)(2 * depth * n_beams));
    Block w = {0};
    Strip *strips = malloc(sizeof *strips * (size_t)windows.count);
    Inner *inner = malloc(sizeof *inner * (size_t)windows.count);
    if (!sums || !turns || !strips || !inner) count = -1;
    else memset(sums, 0, sizeof *sums * (size_t)row);

    for (int64_t i = 0; i < n_lines && count >= 0; i++) {
        /* sum up the lines ahead */
        for (; summed < n_lines && summed <= i + tallest; summed++) {
            double *turned = turns + summed % depth * 2 * n_beams;
            turn_line(sweep->yaws + summed * stride, n_beams, turned);
            add_line(&needed, summed, valid + summed * stride, turned, margin, width,
                     sums + summed % depth * row, sums + (summed + 1) % depth * row);
        }

        /* the table above and below the windows of each height */
        for (int64_t k = 0; k < windows.count; k++) {
            int64_t high = windows.half[k][0], l0 = i > high ? i - high : 0;
            int64_t l1 = i + high + 1 < n_lines ? i + high + 1 : n_lines;
            strips[k] = (Strip){sums + l0 % depth * row, sums + l1 % depth * row, margin, width,
                                l1 - l0, n_beams};
            int64_t next = k + 1 < windows.count ? k + 1 : k;
            inner[k] = (Inner){strips + next, windows.half[next][1], find_gain(windows.half[k], windows.half[next])};
        }

        /* fit windows, largest first */
        const uint8_t *wanted = keep + i * stride;
        const double *turned = turns + i % depth * 2 * n_beams;
        for (int64_t first = 0; first < n_beams; first += BLOCK) {
            int open = read_block(&needed, i, wanted, turned, noise, first, &w);
            if (!open) continue;
            for (int64_t k = 0; k < windows.count && open; k++)
                open = fit_planes(&strips[k], windows.half[k][1], &inner[k], sweep->lever[2],
                                  noise[YAW_SIGMA] * noise[YAW_SIGMA], noise[CORRELATION], &w);
            count = append_surfels(&w, wanted, sweep->yaws + i * stride, n_beams, count, rows, of_rows,
                                   index + i * stride);
        }
    }
    free(sums);
    free(turns);
    free(strips);
    free(inner);
    return count;
}

/* Choose every `stride`-th surfel along lines and beams, beginning half a stride from the corner. */
static void sample_surfels(const int32_t *index, int64_t n_lines, int64_t n_beams, Sample *out) {
    const int64_t stride = out->stride;
    int64_t n = 0;
    for (int64_t i = stride / 2; i < n_lines; i += stride)
        for (int64_t j = stride / 2; j < n_beams; j += stride) {
            int32_t row = index[i * n_beams + j];
            if (row >= 0) out->chosen[n] = row, out->lines[n++] = (int32_t)i;
        }
    out->count = n;
}
