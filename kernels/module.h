/* What the parts of the extension share that take Python objects: the arrays of a call, and the functions of the module. */
#ifndef MEANFLOCK_MODULE_H
#define MEANFLOCK_MODULE_H

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h> /* first */

enum { D = sizeof(double), MOST_ARRAYS = 5, READ = 0, WRITTEN = PyBUF_WRITABLE };

/* The arrays that a call holds so far, and the room it works in. */
typedef struct {
    Py_buffer view[MOST_ARRAYS];
    int held;
    double *room;
} Arrays;

/* Releases all arrays and the room; returns `result`. */
PyObject *done(Arrays *arrays, PyObject *result);

/* Holds one more array, contiguous unless `flags` ask for strides; NULL and an exception where it does not hold numbers
 * of that format and size. */
Py_buffer *hold(Arrays *arrays, PyObject *array, const char *name, const char *format, int size, int flags);

/* Whether an array has so many bytes; an exception where it has not. */
int sized(const Py_buffer *view, const char *name, Py_ssize_t bytes);

/* Holds an array of so many doubles; 0 and an exception where it is none. */
int doubles(Arrays *arrays, PyObject *array, const char *name, Py_ssize_t count, int flags);

/* Holds an array of so many rows, to be read, each of as many items of `width` doubles: how many; -1 and an exception
 * where it is none. */
Py_ssize_t items(Arrays *arrays, PyObject *array, const char *name, Py_ssize_t rows, int width);

/* Room for so many doubles and one more; NULL and an exception without memory. */
double *room_for(Arrays *arrays, Py_ssize_t count);

/* Functions of the module, in wire.c, fading.c and mean_field/learn.c. */
PyObject *wire_read(PyObject *module, PyObject *args);
PyObject *wire_write(PyObject *module, PyObject *args);
PyObject *radio_fade(PyObject *module, PyObject *args);
PyObject *radio_poisson(PyObject *module, PyObject *args);
PyObject *learner_tables(PyObject *module, PyObject *args);
PyObject *learner_step(PyObject *module, PyObject *args);
PyObject *learner_repel(PyObject *module, PyObject *args);

#endif
