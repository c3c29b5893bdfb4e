/* Functions of learner.c for a number of axes; they check their arrays. */
#include "../module.h" /* Python.h comes first */

#include <string.h>

#include "learn.h"

static const char *NAME = DIMENSIONS == 2 ? "meanflock.tables" : "meanflock.tables_in_space";

static void forget(PyObject *capsule) { PyMem_Free(PyCapsule_GetPointer(capsule, NAME)); }

static int all_below(const int32_t *index, int count, int end) {
    for (int k = 0; k < count; k++)
        if (index[k] < 0 || index[k] >= end) return 0;
    return 1;
}

/* Returns whether all indices are within their arrays. */
static int sound(const Tables *t) {
    int few = t->starts[0] == 0 && t->starts[TERMS] == PRODUCTS;
    for (int k = 0; k < TERMS; k++) /* a term has one product at least, and at most TERMS */
        few = few && t->starts[k] < t->starts[k + 1] && t->starts[k + 1] - t->starts[k] <= TERMS;
    return few && all_below(t->value_first, BLOCKS, ALL_POWERS) && all_below(t->value_second, BLOCKS, ALL_POWERS)
        && all_below(t->pair_first, ALL_PAIRS, ALL_POWERS) && all_below(t->pair_second, ALL_PAIRS, ALL_POWERS)
#if DIMENSIONS > 2
        && all_below(t->pair_third, ALL_PAIRS, ALL_POWERS)
#endif
        && all_below(t->at_position, TERMS, PAIRS) && all_below(t->at_velocity, TERMS, PAIRS)
        && all_below(t->left, 2 * DENSITIES, 4 * PAIRS) && all_below(t->right, 2 * DENSITIES, 4 * PAIRS)
        && all_below(t->weight, PRODUCTS, DENSITIES) && all_below(t->term, PRODUCTS, TERMS);
}

PyObject *OF_AXES(learner_tables)(PyObject *module, PyObject *args) {
    PyObject *numbers, *indices, *capsule = NULL;
    Arrays arrays = {.held = 0};
    const Py_ssize_t split = offsetof(Tables, value_first), end = offsetof(Tables, starts) + sizeof((Tables *)0)->starts;
    if (!PyArg_ParseTuple(args, "OO:tables", &numbers, &indices)) return NULL;
    if (!doubles(&arrays, numbers, "numbers", split / D, READ)
        || !sized(hold(&arrays, indices, "indices", "il", 4, READ), "indices", end - split))
        return done(&arrays, NULL);
    Tables *t = PyMem_Calloc(1, sizeof *t);
    if (t == NULL) return done(&arrays, PyErr_NoMemory());
    memcpy(t, arrays.view[0].buf, split);
    memcpy((char *)t + split, arrays.view[1].buf, end - split);
    if (sound(t)) capsule = PyCapsule_New(t, NAME, forget);
    else PyErr_SetString(PyExc_ValueError, "an index of the tables points outside of them");
    if (capsule == NULL) PyMem_Free(t);
    return done(&arrays, capsule);
}

/* Rows of a call from which on they are stepped with AVX-512. Some processors lower their clock for it, which costs small
 * swarms more than it saves them. */
enum { WIDE = 1000 };

/* Three rows are stepped together, too, with an idle lane; two are as fast one by one. */
static void step_rows(const Tables *t, const Rows *rows, Py_ssize_t count) {
    Py_ssize_t from = 0;
#if MANY > 1
    if (count >= WIDE && __builtin_cpu_supports("avx512dq"))
        for (; from <= count - MOST; from += MOST) step_most(t, rows, from, MOST);
    if (__builtin_cpu_supports("avx2"))
        for (Py_ssize_t left; (left = count - from) > 2; from += left < MANY ? left : MANY)
            step_many(t, rows, from, (int)(left < MANY ? left : MANY));
#endif
    for (; from < count; from++) step_one(t, rows, from, 1);
}

/* Writes φ_G of all rows into their numbers: the given one, (M,), or that of the states they know, (M, N, 4). */
static int interaction(Arrays *arrays, PyObject *around, const Tables *t, const Rows *rows, Py_ssize_t count) {
    const Py_ssize_t each = items(arrays, around, "around", count, 1), others = each / VARIABLES;
    double phi_g, *products;
    if (each < 0) return 0;
    if (count && each != 1 && (each == 0 || each % VARIABLES)) {
        PyErr_Format(PyExc_ValueError, "around: %zd bytes for %zd rows", arrays->view[4].len, count);
        return 0;
    }
    if ((products = room_for(arrays, others)) == NULL) return 0;
    for (Py_ssize_t m = 0; m < count; m++) {
        const char *known = (const char *)arrays->view[4].buf + m * each * D;
        if (each == 1) memcpy(&phi_g, known, D);
        else phi_g = empirical(t, rows->states + m * VARIABLES * D, known, others, products);
        memcpy(rows->numbers + (m * NUMBERS + DIMENSIONS + 2) * D, &phi_g, D);
    }
    return 1;
}

PyObject *OF_AXES(learner_step)(PyObject *module, PyObject *args) {
    PyObject *capsule, *states, *weights, *around, *weights_out, *numbers;
    Arrays arrays = {.held = 0};
    if (!PyArg_ParseTuple(args, "OOOOOO:learn", &capsule, &states, &weights, &around, &weights_out, &numbers)) return NULL;
    const Tables *t = PyCapsule_GetPointer(capsule, NAME);
    const Py_ssize_t count = t == NULL ? -1 : items(&arrays, states, "states", 1, VARIABLES);
    if (count < 0 || !doubles(&arrays, weights, "weights", count * WEIGHTS, READ)
        || !doubles(&arrays, weights_out, "weights_out", count * WEIGHTS, WRITTEN)
        || !doubles(&arrays, numbers, "numbers", count * NUMBERS, WRITTEN))
        return done(&arrays, NULL);
    const Py_buffer *of = arrays.view;
    const Rows rows = {of[0].buf, of[1].buf, of[2].buf, of[3].buf, around == Py_None};
    if (around != Py_None && !interaction(&arrays, around, t, &rows, count)) return done(&arrays, NULL);
    if (count < WIDE) {
        step_rows(t, &rows, count);
    } else {
        Py_BEGIN_ALLOW_THREADS /* other agents step their rows meanwhile */
        step_rows(t, &rows, count);
        Py_END_ALLOW_THREADS
    }
    return done(&arrays, Py_NewRef(Py_None));
}

#if DIMENSIONS > 2
/* Number of the doubles in its tables. */
Py_ssize_t numbers_in_space(void) { return offsetof(Tables, value_first) / D; }
#endif
