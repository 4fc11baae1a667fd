/* Algebra of poses and normal equations: algebra.py and pose_prior.py describe it. Matrices are (n, n)
 * in rows of STATE numbers unless they are called dense. */
#pragma once

#include "pairs.h"

#define MIN_SIGNAL_RATIO 2.0        /* least information of a determined direction, per spurious one */
#define MIN_INFORMATION_SHARE 1e-9  /* of the largest information; a direction with less is unknown */

enum {
    MAX_ROTATION_SWEEPS = 30,   /* of the eigenvalue iteration; 5 to 8 are usual */
    KNOTS = 24,                 /* of the range error's curve: up to 5.75 m, constant beyond */
    WIDE = STATE + KNOTS,       /* pose, nuisances, knots */
};

/* Write the eigenvalues of a symmetric matrix, ascending, and its eigenvectors as columns of V, by cyclic
 * Jacobi rotations (Golub and Van Loan, Matrix Computations, 8.5). */
static void find_eigen(const double *M, int n, double *values, double *V) {
    double A[STATE][STATE];
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) A[i][j] = M[STATE * i + j], V[STATE * i + j] = i == j;

    /* rotate until diagonal */
    for (int sweep = 0; sweep < MAX_ROTATION_SWEEPS; sweep++) {
        double off = 0, scale = 0;
        for (int i = 0; i < n; i++)
            for (int j = 0; j <= i; j++)
                *(i == j ? &scale : &off) += A[i][j] * A[i][j];
        if (!(off > 1e-32 * scale)) break;
        for (int p = 0; p < n; p++)
            for (int q = p + 1; q < n; q++) {
                if (A[p][q] == 0) continue;
                double theta = (A[q][q] - A[p][p]) / (2 * A[p][q]);
                double t = (theta < 0 ? -1 : 1) / (fabs(theta) + sqrt(theta * theta + 1));
                double c = 1 / sqrt(t * t + 1), s = t * c;
                for (int k = 0; k < n; k++) {
                    double kp = A[k][p], kq = A[k][q];
                    A[k][p] = c * kp - s * kq, A[k][q] = s * kp + c * kq;
                }
                for (int k = 0; k < n; k++) {
                    double pk = A[p][k], qk = A[q][k];
                    A[p][k] = c * pk - s * qk, A[q][k] = s * pk + c * qk;
                    double vp = V[STATE * k + p], vq = V[STATE * k + q];
                    V[STATE * k + p] = c * vp - s * vq, V[STATE * k + q] = s * vp + c * vq;
                }
            }
    }

    /* sort by eigenvalue */
    for (int i = 0; i < n; i++) values[i] = A[i][i];
    for (int i = 1; i < n; i++)
        for (int j = i; j > 0 && values[j] < values[j - 1]; j--) {
            double swapped = values[j];
            values[j] = values[j - 1], values[j - 1] = swapped;
            for (int k = 0; k < n; k++) {
                swapped = V[STATE * k + j];
                V[STATE * k + j] = V[STATE * k + j - 1], V[STATE * k + j - 1] = swapped;
            }
        }
}

/* Write the inverse of an information matrix; 0 on directions with at most `least` times the largest
 * eigenvalue. */
static void invert_information(const double *information, int n, double least, double *inverse) {
    double values[STATE], V[STATE * STATE];
    find_eigen(information, n, values, V);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            double sum = 0;
            for (int m = 0; m < n; m++)
                if (values[m] > least * values[n - 1])
                    sum += V[STATE * i + m] * V[STATE * j + m] / values[m];
            inverse[STATE * i + j] = sum;
        }
}

/* Write K M K^T. */
static void project(const double *K, const double *M, int n, double *out) {
    double KM[STATE * STATE] = {0};
    for (int i = 0; i < n; i++)
        for (int k = 0; k < n; k++)
            for (int j = 0; j < n; j++) KM[STATE * i + j] += K[STATE * i + k] * M[STATE * k + j];
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            out[STATE * i + j] = 0;
            for (int k = 0; k < n; k++) out[STATE * i + j] += KM[STATE * i + k] * K[STATE * j + k];
        }
}

/* Return v^T M v. */
static double quadratic(const double *M, const double *v, int n) {
    double sum = 0;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) sum += v[i] * M[STATE * i + j] * v[j];
    return sum;
}

/* Directions of the pose that two sweeps determine, and those that they do not. */
typedef struct {
    double kept[STATE * STATE];     /* projector K: K H K^T and K g keep the determined directions */
    double honest[STATE * STATE];   /* K, each direction times the root of its share that is no noise */
    double dropped[POSE][STATE];    /* the degenerate directions, as unit rows */
    int n_dropped;
    double least_signal;            /* least information of a direction, per spurious one */
} Determined;

/* Test each eigenvector of H for degeneracy against the information that noise alone gives; `reach`
 * makes rotations comparable with translations. */
static void find_determined(const double *H, const double *spurious, const int64_t *entries, int n,
                            double reach, Determined *out) {
    double unit[STATE], scaled[STATE * STATE] = {0}, values[STATE], V[STATE * STATE];

    /* eigenvectors, in metres throughout */
    for (int i = 0; i < n; i++) unit[i] = entries[i] < 3 ? 1 : 1 / reach;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) scaled[STATE * i + j] = H[STATE * i + j] * unit[i] * unit[j];
    find_eigen(scaled, n, values, V);
    memset(out, 0, sizeof *out);
    out->least_signal = INFINITY;
    for (int m = 0; m < n; m++) {
        double direction[STATE], square = 0;
        for (int i = 0; i < n; i++) {
            direction[i] = V[STATE * i + m] * unit[i];
            square += direction[i] * direction[i];
        }

        /* drop what noise could give */
        double noise = quadratic(spurious, direction, n);
        double floor = 1e-12 * values[n - 1], least = noise > floor ? noise : floor;
        double signal = values[m] > 0 ? values[m] / least : 0;
        out->least_signal = signal < out->least_signal ? signal : out->least_signal;
        if (!(values[m] > 0 && values[m] >= MIN_SIGNAL_RATIO * least)) {
            for (int i = 0; i < n; i++) out->dropped[out->n_dropped][i] = direction[i] / sqrt(square);
            out->n_dropped++;
            continue;
        }

        /* keep the rest */
        double share = sqrt(1 - noise / values[m]);
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++) {
                double onto = V[STATE * i + m] / unit[i] * direction[j];
                out->kept[STATE * i + j] += onto;
                out->honest[STATE * i + j] += share * onto;
            }
    }
}

/* Normal equations of the state, `size` entries in use, in rows of WIDE. */
typedef struct {
    int size;
    double H[WIDE * WIDE], g[WIDE];
} Wide;

/* Add the prior information `known` of an entry that is now `value`; infinite: leave the entry out. */
static void add_prior(Wide *equations, int entry, double known, double value) {
    double *row = equations->H + WIDE * entry;
    if (!isinf(known)) {
        row[entry] += known, equations->g[entry] += known * value;
        return;
    }
    for (int i = 0; i < equations->size; i++) row[i] = equations->H[WIDE * i + entry] = i == entry;
    equations->g[entry] = 0;
}

/* Take away all that the equations say along directions of the pose (n entries), as if the data could
 * shift along them freely. */
static void drop_directions(const Determined *determined, int n, Wide *equations) {
    for (int m = 0; m < determined->n_dropped; m++) {
        const double *v = determined->dropped[m];
        double Hv[WIDE] = {0}, curvature = 0, slope = 0, scale = 0;
        for (int i = 0; i < n; i++) {
            for (int j = 0; j < equations->size; j++) Hv[j] += equations->H[WIDE * i + j] * v[i];
            slope += v[i] * equations->g[i];
            scale += equations->H[WIDE * i + i] * v[i] * v[i];
        }
        for (int i = 0; i < n; i++) curvature += v[i] * Hv[i];
        if (!(curvature > 1e-12 * scale)) continue;
        for (int i = 0; i < equations->size; i++) {
            equations->g[i] -= Hv[i] * slope / curvature;
            for (int j = 0; j < equations->size; j++)
                equations->H[WIDE * i + j] -= Hv[i] * Hv[j] / curvature;
        }
    }
}

/* Eliminate the entries after the first `n`, last first, by their Schur complements; the row of each stays
 * as it was when it was eliminated. */
static void eliminate_last(Wide *equations, int n) {
    for (int k = equations->size - 1; k >= n; k--) {
        const double *row = equations->H + WIDE * k;
        for (int i = 0; i < k; i++) {
            double share = equations->H[WIDE * i + k] / row[k];
            equations->g[i] -= share * equations->g[k];
            for (int j = 0; j < k; j++) equations->H[WIDE * i + j] -= share * row[j];
        }
    }
}

/* Return the step of entry `k` after those before it, by its row in eliminated equations. */
static double substitute(const Wide *equations, int k, const double *step) {
    double right = equations->g[k];
    for (int j = 0; j < k; j++) right += equations->H[WIDE * k + j] * step[j];
    return -right / equations->H[WIDE * k + k];
}

/* Write T (4, 4) after a motion x y z rx ry rz of the source about its own origin. */
static void displace(const double *T, const double *step, double *out) {
    double x = step[3], y = step[4], z = step[5], square = x * x + y * y + z * z;
    double angle = sqrt(square);
    Turn turn = turn_by(angle);
    double c = turn.c, s = angle < 1e-8 ? 1 : turn.s / angle;
    double v = angle < 1e-8 ? 0.5 : (1 - turn.c) / square;

    /* rotation by Rodrigues' formula */
    const double R[9] = {c + v * x * x, v * x * y - s * z, v * x * z + s * y,
                         v * x * y + s * z, c + v * y * y, v * y * z - s * x,
                         v * x * z - s * y, v * y * z + s * x, c + v * z * z};

    /* turn about the source's origin, then shift */
    double moved[16];
    memcpy(moved, T, sizeof moved);
    for (int i = 0; i < 3; i++) {
        moved[4 * i + 3] = T[4 * i + 3] + step[i];
        for (int j = 0; j < 3; j++)
            moved[4 * i + j] = R[3 * i] * T[j] + R[3 * i + 1] * T[4 + j] + R[3 * i + 2] * T[8 + j];
    }
    memcpy(out, moved, sizeof moved);
}

/* Write the deviation of T from `mean`, both (4, 4), as x y z rx ry rz. */
static void find_deviation(const double *T, const double *mean, double *off) {
    double R[9] = {0};
    for (int i = 0; i < 3; i++) {
        off[i] = T[4 * i + 3] - mean[4 * i + 3];
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 3; k++) R[3 * i + j] += T[4 * i + k] * mean[4 * j + k];
    }
    const double axis[3] = {(R[7] - R[5]) / 2, (R[2] - R[6]) / 2, (R[3] - R[1]) / 2};
    double sine = sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]);
    double angle = angle_of((R[0] + R[4] + R[8] - 1) / 2, sine);
    for (int i = 0; i < 3; i++) off[3 + i] = sine < 1e-9 ? axis[i] : axis[i] * (angle / sine);
}

/* Write the matrix (6, 6) that takes motions about the source's origin to motions about the target's, or
 * back if `sign` is -1. */
static void shift_to_target(const double *T, double sign, double *out) {
    memset(out, 0, sizeof *out * STATE * STATE);
    for (int i = 0; i < POSE; i++) out[STATE * i + i] = 1;
    double x = sign * T[3], y = sign * T[7], z = sign * T[11];
    out[4] = -z, out[STATE + 3] = z;
    out[5] = y, out[2 * STATE + 3] = -y;
    out[STATE + 5] = -x, out[2 * STATE + 4] = x;
}

/* Return the expected RMS displacement of points with mean `a` and second moment M (3, 3) under C:
 * E |d + r x p|^2 = tr D + tr S tr M - tr S M + 2 a . E(d x r). */
static double expect_displacement(const double *a, const double *M, const double *C) {
    double square = 0;
    for (int i = 0; i < 3; i++) {
        square += C[STATE * i + i];
        for (int j = 0; j < 3; j++)
            square += C[STATE * (3 + i) + 3 + i] * M[3 * j + j]
                    - C[STATE * (3 + i) + 3 + j] * M[3 * j + i];
    }
    square += 2 * a[2] * (C[4] - C[STATE + 3]);
    square += 2 * a[0] * (C[STATE + 5] - C[2 * STATE + 4]);
    square += 2 * a[1] * (C[2 * STATE + 3] - C[5]);
    return sqrt(square > 0 ? square : 0);
}
