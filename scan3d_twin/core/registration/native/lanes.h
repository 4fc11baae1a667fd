/* Vectorised sums whose order does not depend on the register width.
 *
 * A sum over an array consists of LANES partial sums, which are added at the end. The result is the same
 * to the last bit whether a processor adds two, four or eight numbers at once. */
#pragma once

#include <string.h>

enum { LANES = 8 };

typedef double Lanes __attribute__((vector_size(8 * LANES)));
typedef int64_t LaneBits __attribute__((vector_size(8 * LANES)));

static inline Lanes load(const double *from) {
    Lanes v;
    memcpy(&v, from, sizeof v);
    return v;
}

static inline double total(Lanes v) {
    return ((v[0] + v[4]) + (v[1] + v[5])) + ((v[2] + v[6]) + (v[3] + v[7]));
}

/* Return `v`, 0 where `known` is NaN. */
static inline Lanes where_known(Lanes known, Lanes v) {
    return (Lanes)((LaneBits)v & (LaneBits)(known == known));
}

static inline int64_t whole_lanes(int64_t n) {
    return (n + LANES - 1) / LANES * LANES;
}

#ifdef __clang__
#define SHUFFLED(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define SHUFFLED(a, b, ...) __builtin_shuffle(a, b, (LaneBits){__VA_ARGS__})
#endif

/* Transpose LANES rows of LANES numbers in place. */
static inline void transpose(Lanes r[LANES]) {
    for (int i = 0; i < LANES; i += 2) {
        Lanes a = r[i], b = r[i + 1];
        r[i] = SHUFFLED(a, b, 0, 8, 2, 10, 4, 12, 6, 14);
        r[i + 1] = SHUFFLED(a, b, 1, 9, 3, 11, 5, 13, 7, 15);
    }
    for (int i = 0; i < LANES; i += i % 4 ? 3 : 1) {
        Lanes a = r[i], b = r[i + 2];
        r[i] = SHUFFLED(a, b, 0, 1, 8, 9, 4, 5, 12, 13);
        r[i + 2] = SHUFFLED(a, b, 2, 3, 10, 11, 6, 7, 14, 15);
    }
    for (int i = 0; i < LANES / 2; i++) {
        Lanes a = r[i], b = r[i + 4];
        r[i] = SHUFFLED(a, b, 0, 1, 2, 3, 8, 9, 10, 11);
        r[i + 4] = SHUFFLED(a, b, 4, 5, 6, 7, 12, 13, 14, 15);
    }
}

static inline void store(double *to, Lanes v) {
    memcpy(to, &v, sizeof v);
}
