/* Filters of the readings of a sweep: see mixed_pixels.py, gap_filling.py, readings.py, costmap.py,
 * fused_cloud.py and virtual_scan.py. Arrays are dense, lines by beams; NaN is no reading. All lines share one row of elevations
 * or rays, or each has its `own`. */
#pragma once

#include "cells.h"

#define TIE 1e-6    /* readings of whole millimetres often differ by just the limit: rounding must not decide [m] */

/* Return 1 if the range steps up from `a` to `b`, beams `angle` apart, by more than the steepest measurable
 * surface allows, -1 if it steps down, else 0. */
static inline int step_between(double a, double b, double angle, double noise, double steepest) {
    double nearer = a < b ? a : b, most = nearer * angle * steepest;
    most = (most > noise ? most : noise) + TIE;
    return (b - a > most) - (b - a < -most);
}

/* Return whether reading 0 of a row, of which reading -1 is missing, is off the plane through readings 1 and 2:
 * on a plane the inverse range is linear. Readings are `stride` doubles apart. */
static inline int is_off_end(const double *r, int64_t stride, double noise) {
    double next = r[stride], second = r[2 * stride], straight = next * second / (2 * second - next);
    return isnan(r[-stride]) && fabs(r[0] - next) > noise + TIE && fabs(r[0] - straight) > noise + TIE;
}

/* Mark the readings with a step of the same sign on both sides, along or across lines, and those off the end
 * of a surface beside which nothing was read. */
static void mark_mixed_pixels(const double *ranges, const double *elevations, int64_t own,
                              const double *yaws, int64_t n_lines, int64_t n_beams, double noise,
                              double steepest, uint8_t *mixed) {
    for (int64_t i = 0; i < n_lines; i++)
        for (int64_t j = 1; j < n_beams - 1; j++) {
            const double *r = ranges + i * n_beams + j, *e = elevations + (own ? i * n_beams : 0) + j;
            int before = step_between(r[-1], r[0], e[0] - e[-1], noise, steepest);
            int after = step_between(r[0], r[1], e[1] - e[0], noise, steepest);
            mixed[i * n_beams + j] |= before * after == 1;
        }
    for (int64_t i = 1; i < n_lines - 1; i++)
        for (int64_t j = 0; j < n_beams; j++) {
            int64_t at = i * n_beams + j, above = at - n_beams, below = at + n_beams;
            int before = step_between(ranges[above], ranges[at], yaws[above] - yaws[at], noise, steepest);
            int after = step_between(ranges[at], ranges[below], yaws[at] - yaws[below], noise, steepest);
            mixed[at] |= before * after == 1;
        }
    for (int64_t i = 1; i < n_lines - 1; i++)
        for (int64_t j = 0; j < n_beams; j++) {
            const double *r = ranges + i * n_beams + j;
            mixed[i * n_beams + j] |= (i + 2 < n_lines && is_off_end(r, n_beams, noise))
                                   || (i > 1 && is_off_end(r, -n_beams, noise));
        }
}

/* Fill the gaps of a row of n readings by linear interpolation over the angle. Readings are `stride`
 * doubles apart, their angles `angle_stride`; `sign` times the angle rises along the row. */
static void fill_row(double *ranges, int64_t n, int64_t stride, const double *angles, int64_t angle_stride,
                     double sign, double max_angle, double depth_edge) {
    int64_t before = -1;
    for (int64_t k = 0; k < n; k++) {
        if (!isfinite(ranges[k * stride])) continue;
        int64_t first = before + 1, a = before;
        before = k;
        if (a < 0 || first == k) continue;
        double start = sign * angles[a * angle_stride], width = sign * angles[k * angle_stride] - start;
        double from = ranges[a * stride], rise = ranges[k * stride] - from;
        if (!(width <= max_angle && fabs(rise) <= depth_edge + TIE)) continue;
        for (int64_t gap = first; gap < k; gap++) {
            double share = (sign * angles[gap * angle_stride] - start) / (width > 0 ? width : 1);
            ranges[gap * stride] = from + share * rise;
        }
    }
}

static void fill_gaps(double *ranges, const double *elevations, int64_t own, const double *yaws,
                      int64_t n_lines, int64_t n_beams, double max_angle, double depth_edge) {
    for (int64_t i = 0; i < n_lines; i++)
        fill_row(ranges + i * n_beams, n_beams, 1, elevations + (own ? i * n_beams : 0), 1, 1, max_angle,
                 depth_edge);
    for (int64_t j = 0; j < n_beams; j++)
        fill_row(ranges + j, n_lines, n_beams, yaws + j, n_beams, -1, max_angle, depth_edge);
}

/* Write the points of n readings, given by ascending index, with their lines, beams and distances from the
 * yaw axis; the base is turned by angles of cosine `c` and sine `s`. */
static void place_readings(const int64_t *index, int64_t n, int64_t n_beams, const double *ranges,
                           const double *c, const double *s, const double *rays, int64_t own,
                           const double *lever, double *points, int64_t *lines, int64_t *beams,
                           double *distance) {
    for (int64_t k = 0, line = 0; k < n; k++) {
        while (index[k] >= (line + 1) * n_beams) line++;
        int64_t beam = index[k] - line * n_beams;
        const double *ray = rays + 3 * (own ? index[k] : beam);
        double *point = points + 3 * k, range = ranges[index[k]];
        point[0] = c[k] * lever[0] - s[k] * lever[1] + range * (c[k] * ray[0] - s[k] * ray[1]);
        point[1] = s[k] * lever[0] + c[k] * lever[1] + range * (s[k] * ray[0] + c[k] * ray[1]);
        point[2] = lever[2] + range * ray[2];
        lines[k] = line, beams[k] = beam;
        distance[k] = hypot(point[0], point[1]);
    }
}

/* Write the ranges at which the rays of n readings, given by ascending index, meet planes of unit normals
 * (n, 3) at `offsets` from the origin; the base is turned by angles of cosine `c` and sine `s`. */
static void meet_planes(const int64_t *index, int64_t n, int64_t n_beams, const double *c, const double *s,
                        const double *rays, int64_t own, const double *lever, const double *normals,
                        const double *offsets, double *ranges) {
    for (int64_t k = 0, line = 0; k < n; k++) {
        while (index[k] >= (line + 1) * n_beams) line++;
        const double *ray = rays + 3 * (own ? index[k] : index[k] - line * n_beams);
        const double *normal = normals + 3 * k;
        double eye = normal[0] * (c[k] * lever[0] - s[k] * lever[1])
                   + normal[1] * (s[k] * lever[0] + c[k] * lever[1]) + normal[2] * lever[2];
        double along = normal[0] * (c[k] * ray[0] - s[k] * ray[1])
                     + normal[1] * (s[k] * ray[0] + c[k] * ray[1]) + normal[2] * ray[2];
        ranges[index[k]] = (offsets[k] - eye) / along;
    }
}

/* Write which rays, as of `meet_planes`, meet their plane ahead and within `limits` (n,) across from the
 * points (n, 3) at which it was seen. */
static void find_near_points(const int64_t *index, int64_t n, int64_t n_beams, const double *c,
                             const double *s, const double *rays, int64_t own, const double *lever,
                             const double *ranges, const double *points, const double *limits,
                             uint8_t *near) {
    for (int64_t k = 0, line = 0; k < n; k++) {
        while (index[k] >= (line + 1) * n_beams) line++;
        const double *straight = rays + 3 * (own ? index[k] : index[k] - line * n_beams);
        const double eye[3] = {c[k] * lever[0] - s[k] * lever[1], s[k] * lever[0] + c[k] * lever[1], lever[2]};
        const double ray[3] = {c[k] * straight[0] - s[k] * straight[1],
                               s[k] * straight[0] + c[k] * straight[1], straight[2]};
        double off[3], along = 0, square = 0, range = ranges[index[k]];
        for (int d = 0; d < 3; d++) {
            off[d] = eye[d] + range * ray[d] - points[3 * k + d];
            along += off[d] * ray[d];
        }
        for (int d = 0; d < 3; d++) {
            double across = off[d] - along * ray[d];
            square += across * across;
        }
        near[k] = sqrt(square) < limits[k] && range > 0;
    }
}

enum { FLOOR = 1, SOLID = 2 };  /* kinds of readings ahead of the robot */

/* Write the distance up to which each line sees a free floor, from n readings sorted by line, at `distance`
 * in the top view. Neighbouring hits of the floor lie at most `most` apart, the first at most that far
 * beyond `start`; an obstacle ends the free floor `margin` before it. `scratch` has room for n. */
static void measure_free_reach(const int64_t *lines, const double *distance, const uint8_t *kinds,
                               int64_t n, int64_t n_lines, double start, double most, double margin,
                               double *scratch, double *reach) {
    int64_t at = 0;
    for (int64_t i = 0; i < n_lines; i++) {
        int64_t count = 0, k = 0;
        double blocked = INFINITY, last = start;

        /* nearest obstacle, and hits of the floor by distance */
        for (; at < n && lines[at] == i; at++) {
            double d = distance[at];
            if (kinds[at] == SOLID) blocked = d < blocked ? d : blocked;
            if (kinds[at] != FLOOR) continue;
            for (k = count++; k > 0 && scratch[k - 1] > d; k--) scratch[k] = scratch[k - 1];
            scratch[k] = d;
        }

        /* unbroken floor up to the obstacle */
        for (k = 0; k < count && !(scratch[k] - last > most); k++) last = scratch[k];
        double free = k > 0 ? last : 0;
        reach[i] = blocked - margin < free ? blocked - margin : free;
    }
}

/* Write, for each of n readings, how many of its eight neighbours can lie on the same surface: one between
 * the two would be no steeper than a lidar can measure. */
static void count_neighbours(const double *ranges, const double *yaws, const double *elevations,
                             int64_t own, int64_t n_lines, int64_t n_beams, const int64_t *lines,
                             const int64_t *beams, int64_t n, double noise, double steepest,
                             int64_t *counts) {
    for (int64_t k = 0; k < n; k++) {
        int64_t i = lines[k], j = beams[k], here = i * n_beams + j;
        counts[k] = 0;
        for (int64_t a = i > 0 ? i - 1 : 0; a <= i + 1 && a < n_lines; a++)
            for (int64_t b = j > 0 ? j - 1 : 0; b <= j + 1 && b < n_beams; b++) {
                int64_t there = a * n_beams + b;
                double r = ranges[here], s = ranges[there], nearer = r < s ? r : s;
                double rise = own ? elevations[here] - elevations[there] : elevations[j] - elevations[b];
                double angle = hypot(yaws[here] - yaws[there], rise);
                double most = nearer * angle * steepest;
                counts[k] += there != here && fabs(r - s) <= (most > noise ? most : noise) + TIE;
            }
    }
}
