/* Which expected faces hide behind surface: see hidden_surface.py. */
#pragma once

#include "floor.h"

/* Slices through the target: grids (n, nx, ny) of cells of side `side` in which surface was seen, whose corners
 * are `origin` and `end`. */
typedef struct {
    const uint8_t *surface;
    int64_t nx, ny;
    const double *origin, *end;
    double side;
} SliceGrids;

/* Return whether a place is on surface in slice `k`. */
static int is_on_surface(const SliceGrids *grids, int64_t k, double x, double y) {
    if (!(x >= grids->origin[0] && y >= grids->origin[1] && x < grids->end[0] && y < grids->end[1])) return 0;
    int64_t i = (int64_t)floor((x - grids->origin[0]) / grids->side);
    int64_t j = (int64_t)floor((y - grids->origin[1]) / grids->side);
    i = i < grids->nx ? i : grids->nx - 1, j = j < grids->ny ? j : grids->ny - 1;
    return grids->surface[(k * grids->nx + i) * grids->ny + j];
}

/* Write which of n faces are hidden from a place by surface in their slice. Rays start one cell in front of
 * the faces; they are tested at `steps` (m,), ascending. */
static void find_hidden(const SliceGrids *grids, const double *points, const double *normals,
                        const int64_t *slices, int64_t n, const double *place, const double *steps, int64_t m,
                        uint8_t *hidden) {
    for (int64_t k = 0; k < n; k++) {
        double x = points[2 * k] + grids->side * normals[2 * k];
        double y = points[2 * k + 1] + grids->side * normals[2 * k + 1];
        double u = place[0] - x, v = place[1] - y, length = sqrt(u * u + v * v);
        length = length > 1e-9 ? length : 1e-9;
        u /= length, v /= length;
        hidden[k] = 0;
        for (int64_t step = 0; step < m && steps[step] < length && !hidden[k]; step++)
            hidden[k] = (uint8_t)is_on_surface(grids, slices[k], x + steps[step] * u, y + steps[step] * v);
    }
}
