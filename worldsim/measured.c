/* What is measured of all pairs of a swarm, and of all models (worldsim/metrics.py, summary.py); the mathematics is in
 * pairs.c and spread.c.
 */
#include "kernel.h"

#include "tick.h"

PyObject *spread_of(PyObject *module, PyObject *args) {
    PyObject *models;
    Py_buffer view;
    Py_ssize_t n, width;
    double bound, apart = -1.0;
    if (!PyArg_ParseTuple(args, "Onnd:spread", &models, &n, &width, &bound)) return NULL;
    if (n < 0 || width < 1 || n > PY_SSIZE_T_MAX / 16 - width || n > PY_SSIZE_T_MAX / 16 / width)
        return PyErr_Format(PyExc_ValueError, "%zd models of %zd weights", n, width);
    if (PyObject_GetBuffer(models, &view, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT) < 0) return NULL;
    double *room = NULL;
    if (holds(&view, n * width)) {
        room = PyMem_Malloc((2 * width + n) * sizeof *room);
        if (room == NULL) PyErr_NoMemory();
        else if (n) apart = spread(view.buf, n, width, bound, room);
    }
    PyMem_Free(room);
    PyBuffer_Release(&view);
    if (PyErr_Occurred()) return NULL;
    if (apart < 0.0) Py_RETURN_NONE;
    return PyFloat_FromDouble(apart);
}

PyObject *distances_of(PyObject *module, PyObject *columns) {
    Py_buffer view;
    if (PyObject_GetBuffer(columns, &view, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT) < 0) return NULL;
    const Py_ssize_t n = view.len / (AXES * (Py_ssize_t)sizeof(double));
    double *room = NULL, sum = 0.0;
    if (holds(&view, n * AXES)) {
        const double *x = view.buf;
        room = PyMem_Malloc((2 * n + 1) * sizeof *room);
        if (room == NULL) PyErr_NoMemory();
        else sum = sum_of_distances(n, x, x + n, room);
    }
    PyMem_Free(room);
    PyBuffer_Release(&view);
    return PyErr_Occurred() ? NULL : PyFloat_FromDouble(sum);
}

typedef struct { Py_ssize_t count, room, *pair; } Pairs;

static int append(void *list, ptrdiff_t i, ptrdiff_t j) {
    Pairs *pairs = list;
    if (pairs->count == pairs->room) {
        const Py_ssize_t room = 2 * pairs->room + 64;
        Py_ssize_t *pair = PyMem_Realloc(pairs->pair, room * 2 * sizeof *pair);
        if (pair == NULL) return 0;
        pairs->room = room;
        pairs->pair = pair;
    }
    pairs->pair[2 * pairs->count] = i;
    pairs->pair[2 * pairs->count++ + 1] = j;
    return 1;
}

PyObject *near_of(PyObject *module, PyObject *args) {
    PyObject *columns, *result = NULL;
    Py_buffer view;
    Pairs touching = {0};
    double reach, most, least;
    if (!PyArg_ParseTuple(args, "Oddd:near", &columns, &reach, &most, &least)) return NULL;
    if (PyObject_GetBuffer(columns, &view, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT) < 0) return NULL;
    const Py_ssize_t n = view.len / (AXES * (Py_ssize_t)sizeof(double));
    if (holds(&view, n * AXES)) {
        const double *x = view.buf;
        const int64_t near = near_pairs(n, x, x + n, reach, most, least, append, &touching);
        if (near < 0) PyErr_NoMemory();
        else result = Py_BuildValue("Ly#", (long long)near, touching.pair == NULL ? "" : (char *)touching.pair,
                                    touching.count * 2 * (Py_ssize_t)sizeof *touching.pair);
    }
    PyMem_Free(touching.pair);
    PyBuffer_Release(&view);
    return result;
}
