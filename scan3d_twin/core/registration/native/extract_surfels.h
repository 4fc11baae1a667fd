/* Extraction of surfels, range noise and yaw jitter from a sweep in one pass: see surfels/grid.py. */
#pragma once

#include "noise.h"

#define DEGREES (TAU / 360)
#define EVEN_LINES 1.5          /* lines that one side of an even sweep may have more than the other */
#define HALF_WINDOWS {2.1 * DEGREES, 1.45 * DEGREES, 0.85 * DEGREES, 0} /* half sizes, largest first */

enum {
    WINDOWS = 4,
    MAX_HALF_WINDOW = 12,     /* readings in half a window; at least one */
    VALID = -1,         /* code of a reading that is a distance, as in types.py */
};

static int64_t readings_in(double angle, double spacing) {
    double n = floor(angle / (spacing > 1e-4 ? spacing : 1e-4) + 0.5);
    return n < 1 ? 1 : n > MAX_HALF_WINDOW ? MAX_HALF_WINDOW : (int64_t)n;
}

/* Return the median angle between two lines, by the yaws of their middle beams. */
static double typical_line_spacing(const Sweep *sweep, double *scratch) {
    const double *middle = sweep->yaws + sweep->n_beams / 2;
    for (int64_t i = 0; i + 1 < sweep->n_lines; i++)
        scratch[i] = fabs(middle[(i + 1) * sweep->stride] - middle[i * sweep->stride]);
    return median(scratch, sweep->n_lines - 1);
}

/* Lines and beams of a part of a sweep. */
typedef struct {
    int64_t first_line, end_line, first_beam, end_beam;
} Extent;

/* Mark the readings that are distances (n,); return their number. */
static int64_t mark_valid(const double *restrict ranges, const int64_t *restrict codes, int64_t n,
                          uint8_t *restrict valid) {
    int64_t count = 0;
    for (int64_t k = 0; k < n; k++) valid[k] = (codes[k] == VALID) & (ranges[k] > 0) & (ranges[k] < INFINITY);
    for (int64_t k = 0; k < n; k++) count += valid[k];
    return count;
}

/* Return the extent of the valid readings. */
static Extent find_extent(const Sweep *sweep, const uint8_t *valid) {
    Extent extent = {sweep->n_lines, 0, sweep->n_beams, 0};
    for (int64_t i = 0; i < sweep->n_lines; i++) {
        const uint8_t *line = valid + i * sweep->stride, *one = memchr(line, 1, (size_t)sweep->n_beams);
        if (!one) continue;
        int64_t first = one - line, end = sweep->n_beams;
        while (!line[end - 1]) end--;
        extent.first_line = i < extent.first_line ? i : extent.first_line;
        extent.end_line = i + 1;
        extent.first_beam = first < extent.first_beam ? first : extent.first_beam;
        extent.end_beam = end > extent.end_beam ? end : extent.end_beam;
    }
    return extent;
}

/* Return the part of a sweep within `extent`. */
static Sweep crop_sweep(const Sweep *sweep, Extent extent) {
    int64_t offset = extent.first_line * sweep->stride + extent.first_beam;
    Sweep part = *sweep;
    part.n_lines = extent.end_line - extent.first_line;
    part.n_beams = extent.end_beam - extent.first_beam;
    part.ranges += offset, part.yaws += offset;
    part.sigmas = sweep->sigmas ? sweep->sigmas + offset : NULL;
    part.rays += extent.first_line * sweep->ray_stride + 3 * extent.first_beam;
    return part;
}

/* Return the mean yaw of the lines about yaw 0, as far as there are lines to both sides; of all lines where there
 * are none on one side. It is the yaw at which an error of the yaw scale moves nothing. */
static double find_middle(const Sweep *sweep, double spacing) {
    const double *middle = sweep->yaws + sweep->n_beams / 2;
    double left = -INFINITY, right = INFINITY, sum = 0;
    int64_t count = 0;
    for (int64_t i = 0; i < sweep->n_lines; i++) {
        double yaw = middle[i * sweep->stride];
        left = yaw > left ? yaw : left, right = yaw < right ? yaw : right;
    }
    double reach = (left < -right ? left : -right) + EVEN_LINES * spacing;
    for (int64_t i = 0; i < sweep->n_lines; i++) {
        double yaw = middle[i * sweep->stride];
        if (reach > 0 && fabs(yaw) > reach) continue;
        sum += yaw, count++;
    }
    return sum / (double)count;
}

/* Write the surfels and the noise of a sweep, whose valid readings are marked. Those that are `wanted`, too, get
 * a surfel; where `noise` is NaN it is estimated. Return 0, or -1 if memory runs out. */
static int extract_surfels(const Sweep *sweep, const uint8_t *wanted, ScanSurfels *out) {
    double *spacings = malloc(sizeof *spacings * (size_t)sweep->n_lines);
    out->count = spacings ? 0 : -1;
    memset(out->index, 0xff, sizeof *out->index * (size_t)(sweep->n_lines * sweep->stride));
    if (out->count < 0) return -1;

    /* extent of the valid readings */
    Extent extent = find_extent(sweep, out->valid);
    out->line_spacing = typical_line_spacing(sweep, spacings);
    if (extent.end_line == 0) {
        const double usual[NOISES] = {DEFAULT_SIGMA, DEFAULT_GROWTH, 0, 1};
        for (int k = 0; k < NOISES; k++)
            out->noise[k] = isnan(out->noise[k]) ? usual[k] : out->noise[k];
        goto done;
    }
    Sweep part = crop_sweep(sweep, extent);
    int64_t offset = part.ranges - sweep->ranges;
    const uint8_t *valid = out->valid + offset;
    int32_t *index = out->index + offset;

    /* noise and windows */
    if (estimate_noise(&part, valid, out->noise) < 0) {
        out->count = -1;
        goto done;
    }
    const double angles[WINDOWS] = HALF_WINDOWS;
    int64_t half[WINDOWS][2];
    for (int k = 0; k < WINDOWS; k++) {
        half[k][0] = readings_in(angles[k], out->line_spacing);
        half[k][1] = readings_in(angles[k], sweep->beam_spacing);
    }
    Windows windows = {WINDOWS, (const int64_t (*)[2])half};

    out->count = fit_surfels(&part, valid, wanted + offset, out->noise, windows, out->rows, out->yaws, index);

    double mean = find_middle(sweep, out->line_spacing);
    for (int64_t k = 0; k < out->count; k++) out->yaws[k] -= mean;
done:
    free(spacings);
    return out->count < 0 ? -1 : 0;
}
