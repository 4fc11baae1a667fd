/* Surfels of a sweep: surfels.py describes the method.
 *
 * Of the summed-area table only the rows in use are kept. The readings of a line are taken WIDE at
 * once, as columns of scratch memory in the fastest cache, by loops without branches. */
#pragma once

#include "angles.h"
#include "engine.h"
#include "lanes.h"
#include <stdlib.h>

#define FILLED 0.6            /* a window counts when this share of its readings is there */
#define TOLERANCE 1.5         /* a plane fits while its rss is within so many sigma of noise alone */
#define MIN_COSINE 0.05       /* flatter than this (87 deg from the normal) no plane is believed */

enum { MOMENTS = 11, WIDE = 128 };

typedef struct {
    int64_t count;
    int32_t beam[WIDE];             /* of each reading, ascending */
    double moments[MOMENTS][WIDE];  /* x x^T (6), x q (3), q^2, 1: see surfels.py */
    double area[WIDE];              /* readings of a whole window */
    double ray[3][WIDE], eye[2][WIDE], inverse_range[WIDE], sigma[WIDE];
    double found[SURFEL][WIDE];     /* the surfels */
    double fits[WIDE];              /* 1 where the plane fits */
} Columns;

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

/* Write a line's row of the summed-area table below another; rows have `margin` + 1 columns before
 * the first beam and `margin` after the last. */
static void add_line(const Sweep *sweep, int64_t line, const uint8_t *valid, const double *turns,
                     int64_t margin, int64_t width, const double *restrict above,
                     double *restrict below) {
    const double *ranges = sweep->ranges + line * sweep->stride;
    const double *rays = sweep->rays + line * sweep->ray_stride;
    double sum[MOMENTS] = {0};
    int64_t n_beams = sweep->n_beams, first = 0, end = n_beams;
    while (first < end && !valid[first]) first++;
    while (end > first && !valid[end - 1]) end--;
    for (int m = 0; m < MOMENTS; m++)
        memcpy(below + m * width, above + m * width, sizeof *below * (size_t)(margin + 1 + first));
    for (int64_t j = first; j < end; j++) {
        if (valid[j]) {
            double q = 1 / ranges[j], c = turns[j], s = turns[n_beams + j];
            double ahead = rays[3 * j] + q * sweep->lever[0];
            double left = rays[3 * j + 1] + q * sweep->lever[1];
            double x = c * ahead - s * left, y = s * ahead + c * left;
            double z = rays[3 * j + 2] + q * sweep->lever[2];
            const double moments[MOMENTS] = {x * x, x * y, x * z, y * y, y * z, z * z,
                                             x * q, y * q, z * q, q * q, 1};
            for (int m = 0; m < MOMENTS; m++) sum[m] += moments[m];
        }
        int64_t at = margin + 1 + j;
        for (int m = 0; m < MOMENTS; m++) below[m * width + at] = above[m * width + at] + sum[m];
    }
    for (int m = 0; m < MOMENTS; m++)
        for (int64_t at = margin + 1 + end; at < width; at++)
            below[m * width + at] = above[m * width + at] + sum[m];
}

/* Read ray, place of the lidar, inverse range and noise of those readings from `first` to `end` of a
 * line that get a surfel. */
static void read_columns(const Sweep *sweep, int64_t line, const uint8_t *keep, const double *turns,
                         const double noise[3], int64_t first, int64_t end, Columns *w) {
    const double *ranges = sweep->ranges + line * sweep->stride;
    const double *rays = sweep->rays + line * sweep->ray_stride;
    const double *sigmas = sweep->sigmas ? sweep->sigmas + line * sweep->stride : NULL;
    double ahead = sweep->lever[0], left = sweep->lever[1];
    w->count = 0;
    for (int64_t j = first; j < end; j++) {
        w->beam[w->count] = (int32_t)j;
        w->count += keep[j];
    }
    for (int64_t k = 0; k < w->count; k++) {
        int64_t j = w->beam[k];
        double c = turns[j], s = turns[sweep->n_beams + j];
        w->ray[0][k] = c * rays[3 * j] - s * rays[3 * j + 1];
        w->ray[1][k] = s * rays[3 * j] + c * rays[3 * j + 1];
        w->ray[2][k] = rays[3 * j + 2];
        w->eye[0][k] = c * ahead - s * left;
        w->eye[1][k] = s * ahead + c * left;
        w->inverse_range[k] = 1 / ranges[j];
        w->sigma[k] = sigmas ? sigmas[j] : noise[0] + noise[1] * ranges[j];
    }
}

/* Write moments and area of the windows of `half` beams to either side around the readings, run by
 * run of neighbouring beams. */
static void sum_windows(const double *restrict above, const double *restrict below, int64_t margin,
                        int64_t width, int64_t half, int64_t n_lines, int64_t n_beams,
                        Columns *restrict w) {
    for (int64_t first = 0, end; first < w->count; first = end) {
        for (end = first + 1; end < w->count && w->beam[end] == w->beam[end - 1] + 1;) end++;
        int64_t n = end - first, left = margin + w->beam[first] - half, right = left + 2 * half + 1;
        for (int m = 0; m < MOMENTS; m++) {
            const double *a = above + m * width, *b = below + m * width;
            double *out = w->moments[m] + first;
            for (int64_t k = 0; k < n; k++)
                out[k] = (b[right + k] - a[right + k]) - (b[left + k] - a[left + k]);
        }
    }
    for (int64_t k = 0; k < w->count; k++) {
        int64_t low = w->beam[k] > half ? w->beam[k] - half : 0;
        int64_t high = w->beam[k] + half + 1 < n_beams ? w->beam[k] + half + 1 : n_beams;
        w->area[k] = (double)(n_lines * (high - low));
    }
}

/* Write the surfels of windows of `lines` lines, and whether the planes fit. */
static void fit_planes(double height, double yaw_variance, int64_t lines, Columns *restrict w) {
    const double per_line = 1 + TOLERANCE * sqrt(2.0 / (double)lines);
    for (int64_t k = 0; k < w->count; k++) {
        double xx = w->moments[0][k], xy = w->moments[1][k], xz = w->moments[2][k];
        double yy = w->moments[3][k], yz = w->moments[4][k], zz = w->moments[5][k];
        double bx = w->moments[6][k], by = w->moments[7][k], bz = w->moments[8][k];
        double qq = w->moments[9][k], readings = w->moments[10][k];
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

        /* point on the ray, and noise along the normal */
        double along = mx * dx + my * dy + mz * dz, square = mx * mx + my * my + mz * mz;
        double r = (1 - (mx * ox + my * oy + mz * height)) / along;
        double x = ox + r * dx, y = oy + r * dy, z = height + r * dz;
        double by_range = along * along * sigma * sigma, scatter = q * q * by_range;

        /* does the plane fit? */
        double rss = qq - mx * bx - my * by - mz * bz, swing = my * x - mx * y;
        double by_yaw = readings * q * q * swing * swing * yaw_variance * per_line;
        double free = readings - 3 > 1 ? readings - 3 : 1;
        double most = scatter * (free + TOLERANCE * sqrt(2 * free)) + by_yaw;
        int fits = (readings >= FILLED * w->area[k]) & (readings > 5) & (r > 0) & (rss <= most)
                 & (det > 1e-12 * trace * trace * trace)
                 & (along * along > MIN_COSINE * MIN_COSINE * square);

        /* noise of the normal */
        double onto = mx * (c_xx * mx + 2 * (c_xy * my + c_xz * mz)) + my * (c_yy * my + 2 * c_yz * mz)
                    + c_zz * mz * mz;
        double tangents = (c_xx + c_yy + c_zz - onto / square) * inverse;
        double towards = (along > 0 ? -1 : 1) / sqrt(square);
        w->found[X][k] = x, w->found[Y][k] = y, w->found[Z][k] = z;
        w->found[NX][k] = towards * mx, w->found[NY][k] = towards * my, w->found[NZ][k] = towards * mz;
        w->found[VARIANCE][k] = by_range / square;
        w->found[NORMAL_VARIANCE][k] = tangents * scatter / (2 * square);
        w->fits[k] = fits ? 1 : 0;
    }
}

/* Copy the surfels that fit to the line's, by beam, and keep the other readings. */
static void take_surfels(Columns *w, double (*surfels)[SURFEL], uint8_t *there) {
    int64_t left = 0;
    for (int64_t k = 0; k < w->count; k++) {
        int32_t beam = w->beam[k];
        there[beam] = w->fits[k] > 0;
        if (there[beam]) {
            for (int m = 0; m < SURFEL; m++) surfels[beam][m] = w->found[m][k];
            continue;
        }
        w->beam[left] = beam;
        for (int i = 0; i < 3; i++) w->ray[i][left] = w->ray[i][k];
        for (int i = 0; i < 2; i++) w->eye[i][left] = w->eye[i][k];
        w->inverse_range[left] = w->inverse_range[k], w->sigma[left++] = w->sigma[k];
    }
    w->count = left;
}

/* Write the surfels of the readings to `keep`; return how many there are. `index` is -1 elsewhere. */
static int64_t fit_surfels(const Sweep *sweep, const uint8_t *valid, const uint8_t *keep,
                           const double noise[3], Windows windows, double *rows, double *of_rows,
                           int32_t *index) {
    int64_t tallest = 0, margin = 0, count = 0, summed = 0;
    for (int64_t k = 0; k < windows.count; k++) {
        tallest = windows.half[k][0] > tallest ? windows.half[k][0] : tallest;
        margin = windows.half[k][1] > margin ? windows.half[k][1] : margin;
    }
    int64_t n_lines = sweep->n_lines, n_beams = sweep->n_beams, stride = sweep->stride;
    int64_t depth = 2 * tallest + 2, width = n_beams + 1 + 2 * margin, row = MOMENTS * width;
    double *sums = malloc(sizeof *sums * (size_t)(depth * row));
    double *turns = malloc(sizeof *turns * (size_t)(2 * depth * n_beams));
    double (*surfels)[SURFEL] = malloc(sizeof *surfels * (size_t)n_beams);
    uint8_t *there = malloc((size_t)n_beams);
    Columns *w = malloc(sizeof *w);
    if (!sums || !turns || !surfels || !there || !w) count = -1;
    else memset(sums, 0, sizeof *sums * (size_t)row);

    for (int64_t i = 0; i < n_lines && count >= 0; i++) {
        /* sum up the lines ahead */
        for (; summed < n_lines && summed <= i + tallest; summed++) {
            double *turned = turns + summed % depth * 2 * n_beams;
            turn_line(sweep->yaws + summed * stride, n_beams, turned);
            add_line(sweep, summed, valid + summed * stride, turned, margin, width,
                     sums + summed % depth * row, sums + (summed + 1) % depth * row);
        }

        /* fit windows, largest first */
        const uint8_t *wanted = keep + i * stride;
        if (!memchr(wanted, 1, (size_t)n_beams)) continue;
        memset(there, 0, (size_t)n_beams);
        for (int64_t first = 0; first < n_beams; first += WIDE) {
            int64_t end = first + WIDE < n_beams ? first + WIDE : n_beams;
            read_columns(sweep, i, wanted, turns + i % depth * 2 * n_beams, noise, first, end, w);
            for (int64_t k = 0; k < windows.count && w->count > 0; k++) {
                int64_t high = windows.half[k][0], l0 = i > high ? i - high : 0;
                int64_t l1 = i + high + 1 < n_lines ? i + high + 1 : n_lines;
                sum_windows(sums + l0 % depth * row, sums + l1 % depth * row, margin, width,
                            windows.half[k][1], l1 - l0, n_beams, w);
                fit_planes(sweep->lever[2], noise[2] * noise[2], l1 - l0, w);
                take_surfels(w, surfels, there);
            }
        }

        /* append them in the order of the beams */
        for (int64_t j = 0; j < n_beams; j++) {
            if (!there[j]) continue;
            memcpy(rows + SURFEL * count, surfels[j], sizeof surfels[j]);
            of_rows[count] = sweep->yaws[i * stride + j];
            index[i * stride + j] = (int32_t)count++;
        }
    }
    free(sums);
    free(turns);
    free(surfels);
    free(there);
    free(w);
    return count;
}

/* Write every `stride`-th surfel along lines and beams, the first half a stride from the corner, as
 * columns (SURFEL, n) of `room` each; return n. */
static int64_t take_sample(const int32_t *index, int64_t n_lines, int64_t n_beams, int64_t stride,
                           const double *rows, const double *of_rows, int64_t room, double *columns,
                           double *yaws, int32_t *lines) {
    int64_t n = 0;
    for (int64_t i = stride / 2; i < n_lines; i += stride)
        for (int64_t j = stride / 2; j < n_beams; j += stride) {
            int32_t row = index[i * n_beams + j];
            if (row < 0) continue;
            for (int m = 0; m < SURFEL; m++) columns[m * room + n] = rows[SURFEL * row + m];
            yaws[n] = of_rows[row], lines[n++] = (int32_t)i;
        }
    return n;
}
