/* What nodes said, from their bytes: answers taken apart, outcomes entered (worldsim/answers.py, commands.py). */
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

/* Whether so many bytes are finite floats, of the format a NumPy dtype has as its character; others are as they are. */
static int sane_floats(const char *text, Py_ssize_t size, char format) {
    int sane = 1;
    if (format == 'd')
        for (Py_ssize_t i = 0; i + 8 <= size; i += 8) {
            uint64_t bits; /* they may begin anywhere */
            memcpy(&bits, text + i, sizeof bits);
            sane &= (bits & 0x7ff0000000000000) != 0x7ff0000000000000;
        }
    else if (format == 'f')
        for (Py_ssize_t i = 0; i + 4 <= size; i += 4) {
            uint32_t bits;
            memcpy(&bits, text + i, sizeof bits);
            sane &= (bits & 0x7f800000) != 0x7f800000;
        }
    else if (format == 'e')
        for (Py_ssize_t i = 0; i + 2 <= size; i += 2) {
            uint16_t bits;
            memcpy(&bits, text + i, sizeof bits);
            sane &= (bits & 0x7c00) != 0x7c00;
        }
    return sane;
}

/* The text that comes next in a message, or NULL, and then with an error if it is none. */
static const char *follows(PyObject *text, const char *at, const char *end) {
    char *expected;
    Py_ssize_t length;
    if (PyBytes_AsStringAndSize(text, &expected, &length) < 0) return NULL;
    return end - at >= length && memcmp(at, expected, length) == 0 ? at + length : NULL;
}

/* The array that comes next, the same way. */
static PyObject *array_at(PyObject *said, char format, const char *at, const char *end) {
    const Py_ssize_t size = PyLong_AsSsize_t(said);
    if (size == -1 && PyErr_Occurred()) return NULL;
    if (size < 0 || end - at < size || !sane_floats(at, size, format)) return NULL;
    return PyBytes_FromStringAndSize(at, size);
}

PyObject *split(PyObject *module, PyObject *const *args, Py_ssize_t count) {
    char *formats, *raw;
    Py_ssize_t arrays, length;
    if (count != 4 || !PyTuple_Check(args[0]) || !PyTuple_Check(args[1]))
        return PyErr_Format(PyExc_TypeError, "split takes two tuples, formats and a message");
    if (PyBytes_AsStringAndSize(args[2], &formats, &arrays) < 0 || PyBytes_AsStringAndSize(args[3], &raw, &length) < 0)
        return NULL;
    if (PyTuple_Size(args[1]) != arrays || PyTuple_Size(args[0]) != arrays + 1)
        return PyErr_Format(PyExc_ValueError, "%zd texts around %zd arrays of %zd formats", PyTuple_Size(args[0]),
                            PyTuple_Size(args[1]), arrays);
    PyObject *parts = PyTuple_New(arrays);
    const char *at = raw, *end = raw + length;
    for (Py_ssize_t k = 0; parts != NULL && k <= arrays; k++) {
        PyObject *part = NULL;
        at = follows(PyTuple_GetItem(args[0], k), at, end);
        if (k < arrays && at != NULL) part = array_at(PyTuple_GetItem(args[1], k), formats[k], at, end);
        if (part != NULL) {
            at += PyBytes_Size(part);
            PyTuple_SetItem(parts, k, part);
        } else if (k < arrays || at != end)
            Py_CLEAR(parts);
    }
    if (parts == NULL && !PyErr_Occurred()) Py_RETURN_NONE;
    return parts;
}
