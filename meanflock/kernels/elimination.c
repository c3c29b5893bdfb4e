/* Compiled form of elimination.py: the same operations in the same order. */
#define LANES 1
#include "module.h" /* Python.h comes first */

#include <math.h>
#include <string.h>

#include "pairwise.h"

/* Replaces `row` by row − factor · `by`, n numbers. */
static TARGET void subtract(ptrdiff_t n, double factor, const double *__restrict by, double *__restrict row) {
    for (ptrdiff_t c = 0; c < n; c++) row[c] -= factor * by[c];
}

/* Adds factor · `by` to `row`, n numbers. */
static TARGET void add(ptrdiff_t n, double factor, const double *__restrict by, double *__restrict row) {
    for (ptrdiff_t c = 0; c < n; c++) row[c] += factor * by[c];
}

/* The row from k on whose number in column k has the largest size; the first one, and the first NaN before all. */
static ptrdiff_t pivot(ptrdiff_t n, ptrdiff_t width, const double *system, ptrdiff_t k) {
    ptrdiff_t best = k;
    double most = -1.0;
    for (ptrdiff_t r = k; r < n && most == most; r++) {
        const double size = fabs(system[r * width + k]);
        if (!(size <= most)) most = size, best = r;
    }
    return best;
}

/* Solves a system (n, n + sides) of a matrix and its right sides beside it; the solution replaces these. */
static void eliminate(ptrdiff_t n, ptrdiff_t sides, double *system) {
    const ptrdiff_t width = n + sides;
    for (ptrdiff_t k = 0; k < n; k++) {
        double *row = system + k * width, *best = system + pivot(n, width, system, k) * width;
        const double divisor = best[k];
        for (ptrdiff_t c = k; c < width; c++) {
            const double number = best[c];
            best[c] = row[c];
            row[c] = number / divisor;
        }
        for (ptrdiff_t r = k + 1; r < n; r++) {
            double *below = system + r * width;
            subtract(width - k, below[k], row + k, below + k);
        }
    }
    for (ptrdiff_t k = n - 1; k > 0; k--)
        for (ptrdiff_t r = 0; r < k; r++)
            subtract(sides, system[r * width + k], system + k * width + n, system + r * width + n);
}

PyObject *elimination_solve(PyObject *module, PyObject *args) {
    PyObject *matrices, *rights, *found;
    Arrays arrays = {.held = 0};
    if (!PyArg_ParseTuple(args, "OOO:solve", &matrices, &rights, &found)) return NULL;
    const Py_buffer *from = hold(&arrays, matrices, "matrices", "d", D, PyBUF_ND);
    if (from == NULL) return done(&arrays, NULL);
    const int is_square = from->ndim == 3 && from->shape[1] == from->shape[2];
    if (!is_square) PyErr_SetString(PyExc_ValueError, "matrices: not (M, n, n)");
    const Py_ssize_t count = is_square ? from->shape[0] : 0, n = is_square ? from->shape[1] : 0;
    const Py_ssize_t sides = is_square ? items(&arrays, rights, "rights", count * n, 1) : -1;
    if (sides < 0 || !doubles(&arrays, found, "found", count * n * sides, WRITTEN)) return done(&arrays, NULL);
    const Py_ssize_t width = n + sides;
    double *system = room_for(&arrays, n * width);
    if (system == NULL) return done(&arrays, NULL);
    const char *matrix = arrays.view[0].buf, *right = arrays.view[1].buf; /* they may be unaligned */
    char *to = arrays.view[2].buf;
    for (Py_ssize_t m = 0; m < count; m++) {
        for (Py_ssize_t r = 0; r < n; r++, matrix += n * D, right += sides * D) {
            memcpy(system + r * width, matrix, n * D);
            memcpy(system + r * width + n, right, sides * D);
        }
        eliminate(n, sides, system);
        for (Py_ssize_t r = 0; r < n; r++, to += sides * D) memcpy(to, system + r * width + n, sides * D);
    }
    return done(&arrays, Py_NewRef(Py_None));
}

PyObject *elimination_multiply(PyObject *module, PyObject *args) {
    PyObject *left, *right, *found;
    Arrays arrays = {.held = 0};
    if (!PyArg_ParseTuple(args, "OOO:multiply", &left, &right, &found)) return NULL;
    const Py_buffer *one = hold(&arrays, left, "left", "d", D, PyBUF_ND);
    const Py_buffer *other = one == NULL ? NULL : hold(&arrays, right, "right", "d", D, PyBUF_ND);
    if (other == NULL) return done(&arrays, NULL);
    const int fit = one->ndim == 3 && other->ndim == 3 && one->shape[2] == other->shape[1] && other->shape[1] > 0
        && (one->shape[0] == other->shape[0] || one->shape[0] == 1 || other->shape[0] == 1);
    if (!fit) {
        PyErr_SetString(PyExc_ValueError, "multiply: not (M, n, m) and (M, m, k), or one of them for all");
        return done(&arrays, NULL);
    }
    const Py_ssize_t n = one->shape[1], terms = one->shape[2], k = other->shape[2];
    const Py_ssize_t count = one->shape[0] == 1 ? other->shape[0] : one->shape[0];
    double *room;
    if (!doubles(&arrays, found, "found", count * n * k, WRITTEN)
        || (room = room_for(&arrays, terms * k + k + terms)) == NULL) /* of one system, because arrays may be unaligned */
        return done(&arrays, NULL);
    double *factors = room + terms * k, *total = factors + terms;
    for (Py_ssize_t m = 0; m < count; m++) {
        const char *from = (const char *)one->buf + (one->shape[0] == 1 ? 0 : m * n * terms * D);
        memcpy(room, (const char *)other->buf + (other->shape[0] == 1 ? 0 : m * terms * k * D), terms * k * D);
        for (Py_ssize_t r = 0; r < n; r++) {
            memcpy(factors, from + r * terms * D, terms * D);
            for (Py_ssize_t c = 0; c < k; c++) total[c] = factors[0] * room[c];
            for (Py_ssize_t t = 1; t < terms; t++) add(k, factors[t], room + t * k, total);
            memcpy((char *)arrays.view[2].buf + (m * n + r) * k * D, total, k * D);
        }
    }
    return done(&arrays, Py_NewRef(Py_None));
}
