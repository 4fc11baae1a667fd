/* Noise of normals over windows that a slanting ray stretches: point_to_plane.py describes it. */
#pragma once

#include "shared_errors.h"

#define MAX_STRETCH 2.0     /* largest variance of a normal along one tangent, per mean over both */

/* Normals, and rays to points, which need no unit length, of the pairs in work. */
typedef struct {
    double normal[3][CHUNK], ray[3][CHUNK];
} Slants;

/* Write the rays to points from a lidar `ahead` of the yaw axis and `up` above the floor, turned by the
 * rows of T; that it may sit a little to the side is neglected. */
static void find_rays(const double *restrict xs, const double *restrict ys, const double *restrict zs,
                      int64_t n, double ahead, double up, const double *T, Slants *restrict s) {
    for (int64_t k = 0; k < n; k++) {
        double rho = sqrt(xs[k] * xs[k] + ys[k] * ys[k]), share = 1 - ahead / (rho > 1e-9 ? rho : 1e-9);
        double x = share * xs[k], y = share * ys[k], z = zs[k] - up;
        for (int i = 0; i < 3; i++) s->ray[i][k] = T[4 * i] * x + T[4 * i + 1] * y + T[4 * i + 2] * z;
    }
}

/* Write the derivatives by turns of the normals about the traces of the rays if `sign` is 1, across them if
 * it is -1, with the information of `n` pairs that these add or take; `variances` are those of the normals. */
static void linearise_tangents(const double *restrict variances, int64_t n, double sign,
                               const Slants *restrict s, Chunk *restrict w) {
    for (int64_t k = 0; k < n; k++) {
        double nx = s->normal[0][k], ny = s->normal[1][k], nz = s->normal[2][k];
        double dx = s->ray[0][k], dy = s->ray[1][k], dz = s->ray[2][k];
        double c = nx * dx + ny * dy + nz * dz, square = dx * dx + dy * dy + dz * dz;
        double x = sign > 0 ? ny * dz - nz * dy : dx - c * nx;
        double y = sign > 0 ? nz * dx - nx * dz : dy - c * ny;
        double z = sign > 0 ? nx * dy - ny * dx : dz - c * nz;
        double ax = w->a[0][k], ay = w->a[1][k], az = w->a[2][k];
        w->J[0][k] = x, w->J[1][k] = y, w->J[2][k] = z;
        w->J[3][k] = ay * z - az * y, w->J[4][k] = az * x - ax * z, w->J[5][k] = ax * y - ay * x;
        w->normal_weight[k] = sign * w->weight[k] * variances[k] / (4 * (square + c * c) + 1e-18);
    }
}

/* Add the information of `n` pairs on the prior's entries to the lower triangle of `spurious`. */
static void add_tangents(int64_t n, const Prior *prior, const Chunk *w, double *spurious) {
    for (int64_t i = 0; i < prior->n_entries; i++)
        for (int64_t m = 0; m <= i; m++) {
            const double *a = w->J[prior->entries[i]], *b = w->J[prior->entries[m]];
            Lanes sum = {0};
            for (int64_t k = 0; k < n; k += LANES)
                sum += load(a + k) * load(w->normal_weight + k) * load(b + k);
            spurious[STATE * i + m] += total(sum);
        }
}

/* Add what stretched windows change of the spurious information of the pairs of a sample at T. */
static void add_stretched_windows(const Target *target, const Sample *sample, const double *T,
                                  const double *nuisances, Gate gate, const PairNoise *noise,
                                  const Prior *prior, Chunk *w, double *spurious) {
    const double *mount = target->projection.mount, same[16] = {[0] = 1, [5] = 1, [10] = 1};
    Slants s;
    Equations unused = {0};
    for (int64_t first = 0; first < sample->count; first += CHUNK) {
        int64_t n = sample->count - first < CHUNK ? sample->count - first : CHUNK;
        gather_pairs(target, sample, first, n, T, w);
        linearise_pairs(n, sample->stride, T, nuisances, gate, noise, w, &unused);
        memcpy(s.normal, w->J, sizeof s.normal);
        clear_rest(n, w);

        /* rays of the source, then of the target */
        for (int own = 1; own >= 0; own--) {
            double (*surfels)[CHUNK] = own ? w->source : w->target;
            const double ahead = own ? noise->ahead : mount[5], up = own ? noise->up : mount[7];
            find_rays(surfels[X], surfels[Y], surfels[Z], n, ahead, up, own ? T : same, &s);
            const double *variances = surfels[NORMAL_VARIANCE];
            linearise_tangents(variances, n, 1, &s, w);
            add_tangents(n, prior, w, spurious);
            linearise_tangents(variances, n, -1, &s, w);
            add_tangents(n, prior, w, spurious);
        }
    }
    mirror(spurious, prior->n_entries);
}
