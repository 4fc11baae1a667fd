/* Binary grids of square cells, and connected components of a sweep: see grids.py and
 * target/extraction.py. */
#pragma once

#include "readings.h"

enum { MAX_DISTANCE = UINT16_MAX };  /* exceeds the width of any disc */

/* Write the distance along the row from each of n cells to the nearest cell that is set. */
static void find_distance(const uint8_t *row, int64_t n, uint16_t *distance) {
    uint16_t away = MAX_DISTANCE;
    for (int64_t j = 0; j < n; j++) {
        away = row[j] ? 0 : away < MAX_DISTANCE ? away + 1 : MAX_DISTANCE;
        distance[j] = away;
    }
    away = MAX_DISTANCE;
    for (int64_t j = n - 1; j >= 0; j--) {
        away = row[j] ? 0 : away < MAX_DISTANCE ? away + 1 : MAX_DISTANCE;
        distance[j] = away < distance[j] ? away : distance[j];
    }
}

/* Dilate a grid (nx, ny) by a disc, given as n_rows pairs: row offset to either side, and half width in
 * cells. Return 0, or -1 if memory runs out. */
static int dilate(const uint8_t *grid, int64_t nx, int64_t ny, const int64_t *disc, int64_t n_rows,
                  uint8_t *out) {
    uint16_t *distance = malloc(sizeof *distance * (size_t)(ny + 1));
    if (!distance) return -1;
    memset(out, 0, (size_t)(nx * ny));
    for (int64_t i = 0; i < nx; i++) {
        if (!memchr(grid + i * ny, 1, (size_t)ny)) continue;
        find_distance(grid + i * ny, ny, distance);
        for (int64_t k = 0; k < n_rows; k++) {
            int64_t away = disc[2 * k];
            int64_t given = disc[2 * k + 1];
            uint16_t half = given < MAX_DISTANCE - 1 ? (uint16_t)given : MAX_DISTANCE - 1;
            for (int64_t to = i - away; to <= i + away; to += away > 0 ? 2 * away : 1) {
                if (to < 0 || to >= nx) continue;
                for (int64_t j = 0; j < ny; j++) out[to * ny + j] |= distance[j] <= half;
            }
        }
    }
    free(distance);
    return 0;
}

/* Label the 8-connected components of a grid (nx, ny): 0 outside of it, else 1, 2, ... in the order of
 * their first cells. Return the number of components, or -1 if memory runs out. */
static int64_t label_components(const uint8_t *grid, int64_t nx, int64_t ny, int32_t *labels) {
    int32_t *open = malloc(sizeof *open * (size_t)(nx * ny + 1)), count = 0;
    if (!open) return -1;
    memset(labels, 0, sizeof *labels * (size_t)(nx * ny));
    for (int64_t first = 0; first < nx * ny; first++) {
        if (!grid[first] || labels[first]) continue;
        int64_t n = 0;
        open[n++] = (int32_t)first, labels[first] = ++count;
        while (n > 0) {
            int64_t at = open[--n], i = at / ny, j = at % ny;
            for (int64_t a = i > 0 ? i - 1 : 0; a <= i + 1 && a < nx; a++)
                for (int64_t b = j > 0 ? j - 1 : 0; b <= j + 1 && b < ny; b++) {
                    int64_t next = a * ny + b;
                    if (!grid[next] || labels[next]) continue;
                    open[n++] = (int32_t)next, labels[next] = count;
                }
        }
    }
    free(open);
    return count;
}

/* Write, for each of n readings of a sweep, the size of its connected component: neighbours along and
 * across lines are connected if their ranges differ by less than `most`. Return 0, or -1 if memory runs
 * out. */
static int measure_components(const double *ranges, int64_t n_lines, int64_t n_beams,
                              const int64_t *lines, const int64_t *beams, int64_t n, double most,
                              int64_t *sizes) {
    size_t readings = (size_t)(n_lines * n_beams);
    int32_t *row = calloc(readings, sizeof *row), *piece = malloc(sizeof *piece * (size_t)(n + 1));
    int done = row && piece ? 0 : -1;   /* row: position in the list, from 1; 0 once visited */
    for (int64_t k = 0; done == 0 && k < n; k++) row[lines[k] * n_beams + beams[k]] = (int32_t)(k + 1);
    for (int64_t first = 0; done == 0 && first < n; first++) {
        int64_t at = lines[first] * n_beams + beams[first], end = 0;
        if (!row[at]) continue;
        piece[end++] = (int32_t)first, row[at] = 0;
        for (int64_t k = 0; k < end; k++) {
            int64_t i = lines[piece[k]], j = beams[piece[k]];
            const int64_t next[4][2] = {{i - 1, j}, {i + 1, j}, {i, j - 1}, {i, j + 1}};
            for (int side = 0; side < 4; side++) {
                int64_t a = next[side][0], b = next[side][1];
                if (a < 0 || a >= n_lines || b < 0 || b >= n_beams || !row[a * n_beams + b]) continue;
                if (!(fabs(ranges[i * n_beams + j] - ranges[a * n_beams + b]) < most)) continue;
                piece[end++] = row[a * n_beams + b] - 1;
                row[a * n_beams + b] = 0;
            }
        }
        for (int64_t k = 0; k < end; k++) sizes[piece[k]] = end;
    }
    free(row);
    free(piece);
    return done;
}
