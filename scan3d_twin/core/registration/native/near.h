/* Fixed-radius neighbour test on a grid of cubes: see kd_tree.py. */
#pragma once

#include "clouds.h"

#define MAX_CUBES (1 << 20)     /* cubes that the points are sorted into, at most */

/* Points sorted into cubes: those of cube k are order[first[k]] to order[first[k + 1] - 1]. */
typedef struct {
    double low[3], high[3], side;
    int64_t size[3];
    int32_t *first, *order;
} Cubes;

static int64_t cube_along(const Cubes *cubes, int axis, double place) {
    int64_t k = (int64_t)floor((place - cubes->low[axis]) / cubes->side);
    return k < 0 ? 0 : k >= cubes->size[axis] ? cubes->size[axis] - 1 : k;
}

static int64_t cube_of(const Cubes *cubes, const double *p) {
    int64_t i = cube_along(cubes, 0, p[0]), j = cube_along(cubes, 1, p[1]);
    return (i * cubes->size[1] + j) * cubes->size[2] + cube_along(cubes, 2, p[2]);
}

/* Lay cubes over the points, with sides of `side` or, if that gives more than MAX_CUBES, larger ones;
 * return their number. */
static int64_t lay_cubes(Cubes *cubes, const double *points, int64_t n, double side) {
    for (int axis = 0; axis < 3; axis++) {
        cubes->low[axis] = INFINITY, cubes->high[axis] = -INFINITY;
        for (int64_t k = 0; k < n; k++) {
            double place = points[3 * k + axis];
            cubes->low[axis] = place < cubes->low[axis] ? place : cubes->low[axis];
            cubes->high[axis] = place > cubes->high[axis] ? place : cubes->high[axis];
        }
    }
    for (cubes->side = side;; cubes->side *= 2) {
        double count = 1;
        for (int axis = 0; axis < 3; axis++)
            count *= floor((cubes->high[axis] - cubes->low[axis]) / cubes->side) + 1;
        if (count > MAX_CUBES) continue;
        for (int axis = 0; axis < 3; axis++)
            cubes->size[axis] = (int64_t)((cubes->high[axis] - cubes->low[axis]) / cubes->side) + 1;
        return (int64_t)count;
    }
}

/* Sort points into cubes; return 0, or -1 if memory runs out. */
static int sort_into_cubes(Cubes *cubes, const double *points, int64_t n, double side) {
    int64_t count = lay_cubes(cubes, points, n, side);
    cubes->first = calloc((size_t)count + 2, sizeof *cubes->first);
    cubes->order = malloc(sizeof *cubes->order * (size_t)n);
    if (!cubes->first || !cubes->order) return -1;
    int32_t *next = cubes->first + 1;   /* sorting advances each entry to the start of the next cube */
    for (int64_t k = 0; k < n; k++) next[cube_of(cubes, points + 3 * k) + 1]++;
    for (int64_t k = 0; k < count; k++) next[k + 1] += next[k];
    for (int64_t k = 0; k < n; k++) cubes->order[next[cube_of(cubes, points + 3 * k)]++] = (int32_t)k;
    return 0;
}

static int is_near(const Cubes *cubes, const double *points, const double *p, double within) {
    int64_t low[3], high[3];
    for (int axis = 0; axis < 3; axis++) {
        if (!(p[axis] >= cubes->low[axis] - within && p[axis] <= cubes->high[axis] + within)) return 0;
        low[axis] = cube_along(cubes, axis, p[axis] - within);
        high[axis] = cube_along(cubes, axis, p[axis] + within);
    }
    for (int64_t i = low[0]; i <= high[0]; i++)
        for (int64_t j = low[1]; j <= high[1]; j++) {
            int64_t row = (i * cubes->size[1] + j) * cubes->size[2];
            int32_t end = cubes->first[row + high[2] + 1];
            for (int32_t at = cubes->first[row + low[2]]; at < end; at++) {
                const double *q = points + 3 * cubes->order[at];
                double x = p[0] - q[0], y = p[1] - q[1], z = p[2] - q[2];
                if (x * x + y * y + z * z < within * within) return 1;
            }
        }
    return 0;
}

/* Mark which of m places have one of n points closer than `within`; return 0, or -1 if memory runs
 * out. */
static int find_near(const double *points, int64_t n, const double *places, int64_t m, double within,
                     uint8_t *near) {
    Cubes cubes = {0};
    int done = n > 0 ? sort_into_cubes(&cubes, points, n, within) : 0;
    for (int64_t k = 0; k < m; k++)
        near[k] = n > 0 && done == 0 && is_near(&cubes, points, places + 3 * k, within);
    free(cubes.first);
    free(cubes.order);
    return done;
}
