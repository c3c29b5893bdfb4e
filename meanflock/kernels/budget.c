/* Compiled form of budget.py: the same operations in the same order. */
#include "module.h" /* Python.h comes first */

#include <math.h>
#include <stdint.h>
#include <string.h>

#define LANES 1
#include "pairwise.h"

static const double COSINE[] = {0.9999999999990572, -19.73920880156809,  64.93939395749398,
                                -85.45681452618881, 60.2445860904632,    -26.425615415608224,
                                7.89915473617536,   -1.6968620513109494, 0.2437498023858064};
enum { LAST = sizeof COSINE / sizeof COSINE[0] - 1 };

static TARGET void cosines(ptrdiff_t count, double x, double y, const double *__restrict along,
                           const double *__restrict across, const double *__restrict phase, double *__restrict found) {
    for (ptrdiff_t m = 0; m < count; m++) {
        double turns = x * along[m] + y * across[m] + phase[m];
        turns -= rint(turns);
        turns *= turns;
        double cosine = COSINE[LAST];
        for (int k = LAST - 1; k >= 0; k--) cosine = cosine * turns + COSINE[k];
        found[m] = cosine;
    }
}

PyObject *radio_waves(PyObject *module, PyObject *args) {
    PyObject *place, *vectors, *phase, *sums;
    Arrays arrays = {.held = 0};
    double *room;
    if (!PyArg_ParseTuple(args, "OOOO:waves", &place, &vectors, &phase, &sums)) return NULL;
    const Py_ssize_t places = items(&arrays, place, "place", 1, 2);
    const Py_ssize_t count = places < 0 ? -1 : items(&arrays, phase, "phase", 1, 1);
    if (count < 0 || !doubles(&arrays, vectors, "vectors", 2 * count, READ)
        || !doubles(&arrays, sums, "sums", places, WRITTEN) || (room = room_for(&arrays, 4 * count)) == NULL)
        return done(&arrays, NULL);
    memcpy(room, arrays.view[2].buf, 2 * count * D); /* arrays may be unaligned */
    memcpy(room + 2 * count, arrays.view[1].buf, count * D);
    for (Py_ssize_t n = 0; n < places; n++) {
        double at[2], sum = 0.0;
        memcpy(at, (const char *)arrays.view[0].buf + 2 * n * D, 2 * D);
        cosines(count, at[0], at[1], room, room + count, room + 2 * count, room + 3 * count);
        if (count) sum = sum_of(room + 3 * count, count);
        memcpy((char *)arrays.view[3].buf + n * D, &sum, D);
    }
    return done(&arrays, Py_NewRef(Py_None));
}

PyObject *radio_interpolate(PyObject *module, PyObject *args) {
    PyObject *tables, *row, *place, *found;
    Arrays arrays = {.held = 0};
    if (!PyArg_ParseTuple(args, "OOOO:interpolate", &tables, &row, &place, &found)) return NULL;
    const Py_buffer *from = hold(&arrays, tables, "tables", "d", D, PyBUF_ND);
    const Py_ssize_t links = from == NULL ? -1 : items(&arrays, place, "place", 1, 1);
    if (links < 0 || !sized(hold(&arrays, row, "row", "lq", D, READ), "row", links * D)) return done(&arrays, NULL);
    int fit = from->ndim == 3 && from->shape[2] >= 2;
    const Py_ssize_t count = fit ? from->shape[0] : 0, rows = fit ? from->shape[1] : 0, columns = fit ? from->shape[2] : 0;
    if (!doubles(&arrays, found, "found", count * links, WRITTEN)) return done(&arrays, NULL);
    const char *all = from->buf, *at = arrays.view[2].buf;
    for (Py_ssize_t k = 0; k < links && fit; k++) fit = (uint64_t)index_at(at, k) < (uint64_t)rows;
    if (!fit) {
        PyErr_SetString(PyExc_ValueError, "interpolate: a row that no table has, or tables of one column");
        return done(&arrays, NULL);
    }
    const double last = (double)(columns - 1);
    for (Py_ssize_t k = 0; k < links; k++) {
        const double given = double_at(arrays.view[1].buf, k), positive = given > 0.0 ? given : 0.0;
        const double inside = positive < last ? positive : last;
        const Py_ssize_t whole = (Py_ssize_t)inside, index = whole < columns - 2 ? whole : columns - 2;
        const double part = inside - (double)index;
        for (Py_ssize_t t = 0; t < count; t++) {
            const Py_ssize_t first = (t * rows + index_at(at, k)) * columns + index;
            const double before = double_at(all, first), number = before + part * (double_at(all, first + 1) - before);
            memcpy((char *)arrays.view[3].buf + (t * links + k) * D, &number, D);
        }
    }
    return done(&arrays, Py_NewRef(Py_None));
}
