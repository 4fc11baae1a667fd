/* Cells of a point cloud, the planes through the points around each, and their pairs: see clouds/patches.py
 * and clouds/pairs.py.
 *
 * The moments of a cell are its number of points, their sum and the sums of their products: CELL_MOMENTS doubles. */
#pragma once

#include "near.h"

enum { CELL_MOMENTS = 10 };
enum { PATCH_X, PATCH_NX = 3, LEAST = 6, MIDDLE, MOST, WINDOW, PATCH };
/* A patch of a cloud is PATCH doubles: centroid, unit normal, the three variances of the points around it,
 * ascending, and their number. */

enum { PAIR_J, PAIR_D = PAIR_J + POSE, PAIR_E = PAIR_D + POSE, SOURCE_VARIANCE, TARGET_VARIANCE, PAIR };
/* A pair is PAIR doubles: Jacobian by the mean normal, half the difference of the Jacobians by either
 * normal, residual, and its variances by the noise of the source and of the target. */

#define MAX_ROOT_STEPS 40           /* Newton steps to the least eigenvalue; 5 to 8 are usual */

/* Return the slot of a cell in a table of a power of two slots, by Teschner et al. (VMV 2003). */
static uint64_t hash_cell(const int32_t *cell, uint64_t mask) {
    uint64_t h = (uint64_t)(uint32_t)cell[0] * 73856093u ^ (uint64_t)(uint32_t)cell[1] * 19349663u
               ^ (uint64_t)(uint32_t)cell[2] * 83492791u;
    return (h ^ h >> 15) & mask;
}

/* Number equal rows of `cells` (n, 3) in the order in which they first occur; write the distinct ones and
 * the number of each row. Return how many there are, or -1 if memory runs out. */
static int64_t number_cells(const int32_t *cells, int64_t n, int32_t *distinct, int32_t *numbers) {
    uint64_t room = 16;
    while (room < 2 * (uint64_t)n) room *= 2;
    int32_t *slots = malloc(sizeof *slots * room);
    if (!slots) return -1;
    memset(slots, 0xff, sizeof *slots * room);
    int64_t m = 0;
    for (int64_t k = 0; k < n; k++) {
        const int32_t *cell = cells + 3 * k;
        uint64_t at = hash_cell(cell, room - 1);
        while (slots[at] >= 0 && memcmp(distinct + 3 * slots[at], cell, 3 * sizeof *cell))
            at = (at + 1) & (room - 1);
        if (slots[at] < 0) {
            memcpy(distinct + 3 * m, cell, 3 * sizeof *cell);
            slots[at] = (int32_t)m++;
        }
        numbers[k] = slots[at];
    }
    free(slots);
    return m;
}

/* Write the cells (n, 3) of points, of sides 1 / `scale`. */
static void find_cells(const double *points, int64_t n, double scale, int32_t *cells) {
    for (int64_t k = 0; k < 3 * n; k++) cells[k] = (int32_t)floor(points[k] * scale);
}

/* Add the moments of points relative to `mean` to those of their cells. */
static void sum_moments(const double *points, const double *mean, const int32_t *numbers, int64_t n,
                        double *sums) {
    for (int64_t k = 0; k < n; k++) {
        double x = points[3 * k] - mean[0], y = points[3 * k + 1] - mean[1], z = points[3 * k + 2] - mean[2];
        const double own[CELL_MOMENTS] = {1, x, y, z, x * x, x * y, x * z, y * y, y * z, z * z};
        for (int i = 0; i < CELL_MOMENTS; i++) sums[CELL_MOMENTS * numbers[k] + i] += own[i];
    }
}

static void add_moments(const double *moments, const int32_t *numbers, int64_t n, double *sums) {
    for (int64_t k = 0; k < n; k++)
        for (int i = 0; i < CELL_MOMENTS; i++) sums[CELL_MOMENTS * numbers[k] + i] += moments[CELL_MOMENTS * k + i];
}

/* Add the moments of the cells whose centroid is closer to a place than the root of `square`. */
static void sum_window(const Tree *tree, int64_t low, int64_t high, const double *from, double square,
                       const double *moments, double *sum) {
    while (high - low > LEAF) {
        int64_t middle = (low + high) / 2;
        double apart = from[tree->axes[middle]] - tree->points[3 * middle + tree->axes[middle]];
        if (apart * apart < square) {
            sum_window(tree, low, middle, from, square, moments, sum);
            const double *p = tree->points + 3 * middle;
            double x = p[0] - from[0], y = p[1] - from[1], z = p[2] - from[2];
            if (x * x + y * y + z * z < square)
                for (int i = 0; i < CELL_MOMENTS; i++) sum[i] += moments[CELL_MOMENTS * middle + i];
            low = middle + 1;
        } else if (apart < 0) high = middle;
        else low = middle + 1;
    }
    for (int64_t place = low; place < high; place++) {
        const double *p = tree->points + 3 * place;
        double x = p[0] - from[0], y = p[1] - from[1], z = p[2] - from[2];
        if (x * x + y * y + z * z < square)
            for (int i = 0; i < CELL_MOMENTS; i++) sum[i] += moments[CELL_MOMENTS * place + i];
    }
}

/* Write centroid, normal, variances and number of the points with moments `sum` as a patch. */
static void fit_patch(const double *sum, double *patch) {
    double n = sum[0], c[3];
    for (int i = 0; i < 3; i++) c[i] = sum[1 + i] / n;
    double xx = sum[4] / n - c[0] * c[0], xy = sum[5] / n - c[0] * c[1], xz = sum[6] / n - c[0] * c[2];
    double yy = sum[7] / n - c[1] * c[1], yz = sum[8] / n - c[1] * c[2], zz = sum[9] / n - c[2] * c[2];

    /* least eigenvalue: Newton steps from 0 rise to the least root of the characteristic polynomial */
    double trace = xx + yy + zz;
    double minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz;
    double det = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz);
    double least = 0;
    for (int step = 0; step < MAX_ROOT_STEPS; step++) {
        double value = ((least - trace) * least + minors) * least - det;
        double slope = (3 * least - 2 * trace) * least + minors;
        if (!(value < 0) || !(slope > 0)) break;
        double next = least - value / slope;
        if (!(next > least * (1 + 1e-10))) break;
        least = next;
    }
    double rest = trace - least, product = minors - least * rest;
    double root = sqrt(fmax(rest * rest / 4 - product, 0));

    /* its eigenvector: the largest cross product of two rows of the matrix less the eigenvalue */
    const double a[3] = {xx - least, xy, xz}, b[3] = {xy, yy - least, yz}, d[3] = {xz, yz, zz - least};
    const double *const rows[3][2] = {{a, b}, {b, d}, {d, a}};
    double best = -1, normal[3] = {1, 0, 0};
    for (int i = 0; i < 3; i++) {
        const double *u = rows[i][0], *v = rows[i][1];
        double w[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
        double square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
        if (square > best) best = square, memcpy(normal, w, sizeof normal);
    }
    double length = sqrt(best);
    for (int i = 0; i < 3; i++) {
        patch[PATCH_X + i] = c[i];
        patch[PATCH_NX + i] = length > 0 ? normal[i] / length : i == 0;
    }
    patch[LEAST] = least, patch[MIDDLE] = fmax(rest / 2 - root, least), patch[MOST] = rest / 2 + root;
    patch[WINDOW] = n;
}

/* What makes a patch flat: see clouds/patches.py. */
typedef struct {
    double points, flatness, width;
} Flat;

static int is_patch_flat(const double *patch, const Flat *flat) {
    return patch[WINDOW] >= flat->points && patch[MIDDLE] >= flat->flatness * patch[LEAST]
        && patch[MIDDLE] >= flat->width * patch[MOST];
}

/* Fit a patch to the cells within the first of `n_radii` at which it is flat, else within the last; `tree`
 * holds their centroids. The least variance is that about the plane, which takes up three points. Return 0,
 * or -1 if memory runs out. */
static int fit_patches(const Tree *tree, const double *moments, const double *radii, int64_t n_radii,
                       const Flat *flat, double *patches, uint8_t *are_flat) {
    double *sorted = malloc(sizeof *sorted * CELL_MOMENTS * (size_t)(tree->n + 1));
    if (!sorted) return -1;
    for (int64_t k = 0; k < tree->n; k++)
        memcpy(sorted + CELL_MOMENTS * k, moments + CELL_MOMENTS * tree->order[k],
               sizeof *sorted * CELL_MOMENTS);
    for (int64_t k = 0; k < tree->n; k++) {
        double *patch = patches + PATCH * tree->order[k];
        uint8_t *found = are_flat + tree->order[k];
        *found = 0;
        for (int64_t i = 0; i < n_radii && !*found; i++) {
            double sum[CELL_MOMENTS] = {0};
            sum_window(tree, 0, tree->n, tree->points + 3 * k, radii[i] * radii[i], sorted, sum);
            fit_patch(sum, patch);
            double n = patch[WINDOW];
            patch[LEAST] *= n / (n > 4 ? n - 3 : 1);
            *found = (uint8_t)is_patch_flat(patch, flat);
        }
    }
    free(sorted);
    return 0;
}

/* The nearest patch to a place whose normal is at most at the angle of `cosine` to `normal`. */
typedef struct {
    const double *from, *normal, *patches;
    double cosine, square;
    int64_t place;
} Partner;

static inline void keep_if_alike(const Tree *tree, int64_t place, Partner *partner) {
    const double *p = tree->points + 3 * place, *from = partner->from;
    double x = p[0] - from[0], y = p[1] - from[1], z = p[2] - from[2], square = x * x + y * y + z * z;
    if (!(square < partner->square)) return;
    const double *n = partner->patches + PATCH * tree->order[place] + PATCH_NX, *own = partner->normal;
    if (n[0] * own[0] + n[1] * own[1] + n[2] * own[2] < partner->cosine) return;
    partner->square = square, partner->place = place;
}

static void search_partner(const Tree *tree, int64_t low, int64_t high, Partner *partner) {
    while (high - low > LEAF) {
        int64_t middle = (low + high) / 2;
        int axis = tree->axes[middle];
        double apart = partner->from[axis] - tree->points[3 * middle + axis];
        search_partner(tree, apart < 0 ? low : middle + 1, apart < 0 ? middle : high, partner);
        if (apart * apart >= partner->square) return;
        keep_if_alike(tree, middle, partner);
        if (apart < 0) low = middle + 1;
        else high = middle;
    }
    for (int64_t place = low; place < high; place++) keep_if_alike(tree, place, partner);
}

/* Write the Jacobian (n, a x n) of a point-to-plane residual. */
static inline void write_jacobian(const double *n, const double *a, double *J) {
    J[0] = n[0], J[1] = n[1], J[2] = n[2];
    J[3] = a[1] * n[2] - a[2] * n[1], J[4] = a[2] * n[0] - a[0] * n[2], J[5] = a[0] * n[1] - a[1] * n[0];
}

/* Return the variance of a residual by the noise of one patch: that of its centroid along the normal, and of
 * half its normal times the distance to the other centroid. */
static double vary_residual(const double *patch, double square) {
    return patch[LEAST] / patch[WINDOW] * (1 + square / (4 * patch[MIDDLE] + 1e-30));
}

/* Pair each of m source patches moved by T with the nearest target patch alike within `gate`; write pairs and
 * the indices (., 2) of source and target. Return their number. */
static int64_t pair_patches(const Tree *tree, const double *targets, const double *sources, int64_t m,
                           const double *T, double gate, double cosine, double *pairs, int32_t *indices) {
    int64_t count = 0;
    for (int64_t k = 0; k < m; k++) {
        const double *s = sources + PATCH * k;
        double a[3], p[3], n[3];
        for (int i = 0; i < 3; i++) {
            a[i] = T[4 * i] * s[0] + T[4 * i + 1] * s[1] + T[4 * i + 2] * s[2];
            p[i] = a[i] + T[4 * i + 3];
            n[i] = T[4 * i] * s[3] + T[4 * i + 1] * s[4] + T[4 * i + 2] * s[5];
        }
        Partner partner = {p, n, targets, cosine, gate * gate, -1};
        search_partner(tree, 0, tree->n, &partner);
        if (partner.place < 0) continue;

        /* residual along the mean normal */
        const double *t = targets + PATCH * tree->order[partner.place];
        double mean[3], half[3], square = 0, e = 0;
        for (int i = 0; i < 3; i++) {
            mean[i] = n[i] + t[PATCH_NX + i], half[i] = (n[i] - t[PATCH_NX + i]) / 2;
            square += mean[i] * mean[i];
        }
        for (int i = 0; i < 3; i++) mean[i] /= sqrt(square), e += mean[i] * (p[i] - t[i]);
        double *pair = pairs + PAIR * count;
        write_jacobian(mean, a, pair + PAIR_J);
        write_jacobian(half, a, pair + PAIR_D);
        pair[PAIR_E] = e;
        pair[SOURCE_VARIANCE] = vary_residual(s, partner.square);
        pair[TARGET_VARIANCE] = vary_residual(t, partner.square);
        indices[2 * count] = (int32_t)k, indices[2 * count + 1] = tree->order[partner.place];
        count++;
    }
    return count;
}
