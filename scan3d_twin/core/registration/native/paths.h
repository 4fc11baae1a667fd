/* Shortest paths on a grid of square cells by Dijkstra's algorithm: see grids.py. */
#pragma once

#include "hidden.h"

/* A binary heap of cells by the length of their paths, and by their index where these are equal; `at` is the
 * place of a cell in the heap, or one of the marks below. */
typedef struct {
    const double *lengths;
    int64_t *cells, *at, count;
} PathHeap;

enum { NOT_REACHED = -1, SETTLED = -2 };

static inline int comes_first(const PathHeap *heap, int64_t a, int64_t b) {
    double x = heap->lengths[a], y = heap->lengths[b];
    return x < y || (x == y && a < b);
}

static void rise(PathHeap *heap, int64_t cell, int64_t place) {
    for (int64_t above; place > 0; place = above) {
        above = (place - 1) / 2;
        if (!comes_first(heap, cell, heap->cells[above])) break;
        heap->cells[place] = heap->cells[above];
        heap->at[heap->cells[place]] = place;
    }
    heap->cells[place] = cell, heap->at[cell] = place;
}

static int64_t take_first(PathHeap *heap) {
    int64_t first = heap->cells[0], last = heap->cells[--heap->count], place = 0;
    for (int64_t below; (below = 2 * place + 1) < heap->count; place = below) {
        if (below + 1 < heap->count && comes_first(heap, heap->cells[below + 1], heap->cells[below])) below++;
        if (!comes_first(heap, heap->cells[below], last)) break;
        heap->cells[place] = heap->cells[below];
        heap->at[heap->cells[place]] = place;
    }
    if (heap->count) heap->cells[place] = last, heap->at[last] = place;
    heap->at[first] = SETTLED;
    return first;
}

/* Write the length of the path from `start` to each cell that is set in `grid` (nx, ny), and the cell before it;
 * infinity and -1 where there is none. A step costs `straight`, or `diagonal` to one of the other four
 * neighbours. Return 0, or -1 if memory runs out. */
static int find_shortest_paths(const uint8_t *grid, int64_t nx, int64_t ny, int64_t start, double straight,
                               double diagonal, double *lengths, int64_t *before) {
    size_t n = (size_t)(nx * ny);
    int64_t *scratch = malloc(sizeof *scratch * 2 * n);
    if (!scratch) return -1;
    PathHeap heap = {lengths, scratch, scratch + n, 0};
    for (size_t k = 0; k < n; k++) lengths[k] = INFINITY, before[k] = -1, heap.at[k] = NOT_REACHED;

    lengths[start] = 0;
    rise(&heap, start, heap.count++);
    while (heap.count) {
        int64_t cell = take_first(&heap), i = cell / ny, j = cell % ny;
        for (int64_t u = i > 0 ? i - 1 : 0; u <= i + 1 && u < nx; u++)
            for (int64_t v = j > 0 ? j - 1 : 0; v <= j + 1 && v < ny; v++) {
                int64_t next = u * ny + v;
                double length = lengths[cell] + (u != i && v != j ? diagonal : straight);
                if (!grid[next] || heap.at[next] == SETTLED || !(length < lengths[next])) continue;
                lengths[next] = length, before[next] = cell;
                rise(&heap, next, heap.at[next] == NOT_REACHED ? heap.count++ : heap.at[next]);
            }
    }
    free(scratch);
    return 0;
}
