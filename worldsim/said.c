/* What nodes said, from their bytes: outcomes entered (worldsim/commands.py). */
#include "kernel.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "tick.h"

enum { ROW = OUTCOME * sizeof(double) }; /* bytes of an outcome */

/* How many rows there are in a list of bytes; -1 where that is not what it is. */
static Py_ssize_t rows_of(PyObject *said) {
    Py_ssize_t rows = 0;
    for (Py_ssize_t k = 0; k < PyList_Size(said); k++) {
        PyObject *text = PyList_GetItem(said, k);
        if (!PyBytes_Check(text) || PyBytes_Size(text) % ROW) {
            PyErr_Format(PyExc_ValueError, "item %zd is not the bytes of rows of %d doubles", k, OUTCOME);
            return -1;
        }
        rows += PyBytes_Size(text) / ROW;
    }
    return rows;
}

/* The largest of each column, or 0 where one is not below the bound. */
static int largest(PyObject *said, double bound, double *most) {
    for (Py_ssize_t k = 0; k < PyList_Size(said); k++) {
        const char *text = PyBytes_AsString(PyList_GetItem(said, k));
        const Py_ssize_t count = PyBytes_Size(PyList_GetItem(said, k)) / (Py_ssize_t)sizeof(double);
        for (Py_ssize_t i = 0; i < count; i++) {
            double number; /* bytes may begin anywhere */
            memcpy(&number, text + i * (Py_ssize_t)sizeof number, sizeof number);
            if (!(fabs(number) < bound)) return 0; /* NaN is below nothing */
            if (fabs(number) > most[i % OUTCOME]) most[i % OUTCOME] = fabs(number);
        }
    }
    return 1;
}

static void copy(PyObject *said, double *commands, double *told) {
    for (Py_ssize_t k = 0; k < PyList_Size(said); k++) {
        const char *text = PyBytes_AsString(PyList_GetItem(said, k));
        for (Py_ssize_t left = PyBytes_Size(PyList_GetItem(said, k)); left; left -= ROW, text += ROW) {
            memcpy(commands, text, AXES * sizeof(double));
            memcpy(told, text + AXES * sizeof(double), (OUTCOME - AXES) * sizeof(double));
            commands += AXES;
            told += OUTCOME - AXES;
        }
    }
}

PyObject *enter(PyObject *module, PyObject *args) {
    PyObject *said, *array[2], *result = NULL;
    Py_buffer view[2];
    double bound, most[OUTCOME] = {0.0};
    int held = 0;
    if (!PyArg_ParseTuple(args, "O!dOO:enter", &PyList_Type, &said, &bound, &array[0], &array[1])) return NULL;
    for (; held < 2; held++)
        if (PyObject_GetBuffer(array[held], &view[held], PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | PyBUF_WRITABLE) < 0) goto done;
    const Py_ssize_t n = rows_of(said);
    if (n < 0 || !holds(&view[0], n * AXES) || !holds(&view[1], n * (OUTCOME - AXES))) goto done;
    if (!largest(said, bound, most)) {
        Py_INCREF(result = Py_None);
        goto done;
    }
    copy(said, view[0].buf, view[1].buf);
    result = Py_BuildValue("dd", most[AXES], most[AXES + 1]);
done:
    while (held--) PyBuffer_Release(&view[held]);
    return result;
}
