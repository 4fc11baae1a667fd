/* Means over moving windows of an array: see moving_windows.py. */
#pragma once

#include "paths.h"

/* Return the entry (0 to n - 1) that stands for entry `i` of an array whose ends are mirrors. */
static int64_t mirrored(int64_t i, int64_t n) {
    i %= 2 * n;
    i += i < 0 ? 2 * n : 0;
    return i < n ? i : 2 * n - 1 - i;
}

/* Write the means over windows of `size` along the middle axis of `values` (outer, n, inner). Return 0, or -1 if
 * memory runs out. */
static int average_windows(const double *values, int64_t outer, int64_t n, int64_t inner, int64_t size,
                           double *out) {
    double *restrict sums = malloc(sizeof *sums * (size_t)inner);
    int64_t before = size / 2, after = size - 1 - before;
    if (!sums) return -1;
    for (int64_t o = 0; o < outer; o++, values += n * inner, out += n * inner) {
        memcpy(sums, values + mirrored(-before, n) * inner, sizeof *sums * (size_t)inner);
        for (int64_t i = 1 - before; i <= after; i++) {
            const double *enters = values + mirrored(i, n) * inner;
            for (int64_t k = 0; k < inner; k++) sums[k] += enters[k];
        }
        for (int64_t k = 0; k < inner; k++) out[k] = sums[k] / (double)size;

        /* what enters and leaves each further window */
        for (int64_t i = 1; i < n; i++) {
            const double *enters = values + mirrored(i + after, n) * inner;
            const double *leaves = values + mirrored(i - 1 - before, n) * inner;
            double *restrict to = out + i * inner;
            for (int64_t k = 0; k < inner; k++) {
                sums[k] += enters[k] - leaves[k];
                to[k] = sums[k] / (double)size;
            }
        }
    }
    free(sums);
    return 0;
}
