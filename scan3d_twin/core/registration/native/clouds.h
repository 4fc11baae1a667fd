/* Nearest neighbours and plane fits of unorganised point clouds: see kd_tree.py and
 * clouds/patches.py.
 *
 * Neighbours come from a balanced k-d tree (Bentley 1975), stored as an order of the points: those between
 * `low` and `high` are split at their median along the widest side of their bounding box. */
#pragma once

#include "free_space.h"

enum { LEAF = 12, MAX_NEIGHBOURS = 64 };

/* `points` (n, 3) in the order of the tree, `order` (n,) their former indices, `axes` (n,) of the splits at
 * the positions of the medians. */
typedef struct {
    int64_t n;
    double *points;
    int32_t *order;
    uint8_t *axes;
} Tree;

static void swap_points(Tree *tree, int64_t a, int64_t b) {
    for (int i = 0; i < 3; i++) {
        double swapped = tree->points[3 * a + i];
        tree->points[3 * a + i] = tree->points[3 * b + i];
        tree->points[3 * b + i] = swapped;
    }
    int32_t swapped = tree->order[a];
    tree->order[a] = tree->order[b];
    tree->order[b] = swapped;
}

static int widest_axis(const double *points, int64_t low, int64_t high) {
    int axis = 0;
    double widest = -1;
    for (int i = 0; i < 3; i++) {
        double least = points[3 * low + i], most = least;
        for (int64_t k = low + 1; k < high; k++) {
            double v = points[3 * k + i];
            least = v < least ? v : least, most = v > most ? v : most;
        }
        if (most - least > widest) widest = most - least, axis = i;
    }
    return axis;
}

/* Reorder the points from `low` to `high` so that the k-th along an axis is at its sorted position. */
static void select_point(Tree *tree, int64_t low, int64_t high, int64_t k, int axis) {
    const double *p = tree->points + axis;
    for (high--; low < high;) {
        double pivot = p[3 * (low + (high - low) / 2)];
        int64_t i = low, j = high;
        while (i <= j) {
            while (p[3 * i] < pivot) i++;
            while (p[3 * j] > pivot) j--;
            if (i <= j) swap_points(tree, i++, j--);
        }
        if (k <= j) high = j;
        else if (k >= i) low = i;
        else return;
    }
}

static void build_tree(Tree *tree, int64_t low, int64_t high) {
    while (high - low > LEAF) {
        int64_t middle = (low + high) / 2;
        int axis = widest_axis(tree->points, low, high);
        select_point(tree, low, high, middle, axis);
        tree->axes[middle] = (uint8_t)axis;
        build_tree(tree, low, middle);
        low = middle + 1;
    }
}

/* The nearest points found up to now, farthest last. */
typedef struct {
    int64_t wanted, count;
    double squares[MAX_NEIGHBOURS];
    int32_t places[MAX_NEIGHBOURS];
} Nearest;

static inline void keep_if_nearer(const Tree *tree, const double *from, int64_t place, Nearest *nearest) {
    const double *p = tree->points + 3 * place;
    double x = p[0] - from[0], y = p[1] - from[1], z = p[2] - from[2], square = x * x + y * y + z * z;
    int64_t k = nearest->count;
    if (k == nearest->wanted && !(square < nearest->squares[k - 1])) return;
    k -= k == nearest->wanted;
    for (; k > 0 && nearest->squares[k - 1] > square; k--) {
        nearest->squares[k] = nearest->squares[k - 1];
        nearest->places[k] = nearest->places[k - 1];
    }
    nearest->squares[k] = square, nearest->places[k] = (int32_t)place;
    nearest->count += nearest->count < nearest->wanted;
}

static void search_tree(const Tree *tree, int64_t low, int64_t high, const double *from,
                        Nearest *nearest) {
    while (high - low > LEAF) {
        int64_t middle = (low + high) / 2;
        int axis = tree->axes[middle];
        double apart = from[axis] - tree->points[3 * middle + axis];
        search_tree(tree, apart < 0 ? low : middle + 1, apart < 0 ? middle : high, from, nearest);
        keep_if_nearer(tree, from, middle, nearest);
        int64_t last = nearest->count - 1;
        if (nearest->count == nearest->wanted && apart * apart >= nearest->squares[last]) return;
        if (apart < 0) low = middle + 1;
        else high = middle;
    }
    for (int64_t place = low; place < high; place++) keep_if_nearer(tree, from, place, nearest);
}

/* Write squared distances and indices (m, k) of the k nearest points of the tree, nearest first;
 * infinity and -1 where there are fewer. */
static void find_nearest(const Tree *tree, const double *from, int64_t m, int64_t k, double *squares,
                         int32_t *indices) {
    for (int64_t i = 0; i < m; i++) {
        Nearest nearest = {.wanted = k};
        search_tree(tree, 0, tree->n, from + 3 * i, &nearest);
        for (int64_t j = 0; j < k; j++) {
            int there = j < nearest.count;
            squares[k * i + j] = there ? nearest.squares[j] : INFINITY;
            indices[k * i + j] = there ? tree->order[nearest.places[j]] : -1;
        }
    }
}

/* The closest point found up to now: its squared distance and its place in the tree. */
typedef struct {
    double square;
    int64_t place;
} Closest;

/* Search the points from `low` to `high`, which are at least `off` away along each axis (Arya and Mount, DCC
 * 1993). Squares of these are never above those of the points, rounded or not, so that none is missed. */
static void search_closest(const Tree *tree, int64_t low, int64_t high, const double *from,
                           const double *off, Closest *closest) {
    if (high - low > LEAF) {
        int64_t middle = (low + high) / 2;
        int axis = tree->axes[middle];
        const double *p = tree->points + 3 * middle;
        double apart = from[axis] - p[axis], beyond[3] = {off[0], off[1], off[2]};
        search_closest(tree, apart < 0 ? low : middle + 1, apart < 0 ? middle : high, from, off, closest);
        double x = p[0] - from[0], y = p[1] - from[1], z = p[2] - from[2], square = x * x + y * y + z * z;
        if (square < closest->square) closest->square = square, closest->place = middle;
        beyond[axis] = apart;
        if (beyond[0] * beyond[0] + beyond[1] * beyond[1] + beyond[2] * beyond[2] >= closest->square)
            return;
        search_closest(tree, apart < 0 ? middle + 1 : low, apart < 0 ? high : middle, from, beyond, closest);
        return;
    }
    for (int64_t place = low; place < high; place++) {
        const double *p = tree->points + 3 * place;
        double x = p[0] - from[0], y = p[1] - from[1], z = p[2] - from[2], square = x * x + y * y + z * z;
        if (square < closest->square) closest->square = square, closest->place = place;
    }
}

/* Write distances and indices (m,) of the closest points of the tree that are closer than `within`; infinity
 * and n where there is none. */
static void find_closest(const Tree *tree, const double *from, int64_t m, double within, double *distances,
                         int64_t *indices) {
    for (int64_t i = 0; i < m; i++) {
        Closest closest = {within * within, -1};
        search_closest(tree, 0, tree->n, from + 3 * i, (const double[3]){0}, &closest);
        int there = closest.place >= 0;
        distances[i] = there ? sqrt(closest.square) : INFINITY;
        indices[i] = there ? tree->order[closest.place] : tree->n;
    }
}

/* Fit a plane to the k nearest neighbours of each point of the tree: write centroid, unit normal and the
 * two smaller variances, in the original order of the points. */
static void fit_neighbourhoods(const Tree *tree, int64_t k, double *centroids, double *normals,
                               double *variances) {
    for (int64_t i = 0; i < tree->n; i++) {
        Nearest nearest = {.wanted = k};
        search_tree(tree, 0, tree->n, tree->points + 3 * i, &nearest);

        /* centroid and covariance */
        double sum[3] = {0}, M[STATE * STATE] = {0}, values[STATE], V[STATE * STATE];
        for (int64_t j = 0; j < nearest.count; j++)
            for (int a = 0; a < 3; a++)
                sum[a] += tree->points[3 * nearest.places[j] + a] / (double)nearest.count;
        for (int64_t j = 0; j < nearest.count; j++)
            for (int a = 0; a < 3; a++)
                for (int b = 0; b < 3; b++)
                    M[STATE * a + b] += (tree->points[3 * nearest.places[j] + a] - sum[a])
                                      * (tree->points[3 * nearest.places[j] + b] - sum[b])
                                      / (double)nearest.count;

        /* normal: direction of least variance */
        find_eigen(M, 3, values, V);
        int64_t at = tree->order[i];
        for (int a = 0; a < 3; a++) {
            centroids[3 * at + a] = sum[a];
            normals[3 * at + a] = V[STATE * a];
        }
        variances[2 * at] = values[0], variances[2 * at + 1] = values[1];
    }
}
