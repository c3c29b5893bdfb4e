/* Shared by the files of the extension that take Python objects: arrays of a call, and functions of the module. */
#ifndef MEANFLOCK_MODULE_H
#define MEANFLOCK_MODULE_H

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h> /* first */

#include <stdint.h>
#include <string.h>

enum { D = sizeof(double), MOST_ARRAYS = 7, READ = 0, WRITTEN = PyBUF_WRITABLE };

/* The arrays that a call holds, and its working memory. */
typedef struct {
    Py_buffer view[MOST_ARRAYS];
    int held;
    double *room;
} Arrays;

/* Releases all arrays and the room; returns `result`. */
PyObject *done(Arrays *arrays, PyObject *result);

/* Holds one more array, contiguous unless `flags` ask for strides; returns NULL and sets an exception if its numbers have
 * another format or size. */
Py_buffer *hold(Arrays *arrays, PyObject *array, const char *name, const char *format, int size, int flags);

/* Returns whether an array has that many bytes; sets an exception if not. */
int sized(const Py_buffer *view, const char *name, Py_ssize_t bytes);

/* A number of an array, which may begin at any byte. */
static inline double double_at(const char *array, Py_ssize_t place) {
    double number;
    memcpy(&number, array + place * D, D);
    return number;
}

static inline int64_t index_at(const char *array, Py_ssize_t place) {
    int64_t number;
    memcpy(&number, array + place * D, D);
    return number;
}

/* Holds an array of that many doubles; returns 0 and sets an exception if it is another. */
int doubles(Arrays *arrays, PyObject *array, const char *name, Py_ssize_t count, int flags);

/* Holds an array (rows, items, width) of doubles, to be read; returns the number of items, or -1 and sets an exception if
 * it has another shape. */
Py_ssize_t items(Arrays *arrays, PyObject *array, const char *name, Py_ssize_t rows, int width);

/* Holds rows of so many vectors each, (..., vectors · axes) of doubles, to be read; returns their number and writes their
 * axes, or returns -1 and sets an exception if they have neither the columns of the plane nor those of space. */
Py_ssize_t rows_of(Arrays *arrays, PyObject *array, const char *name, int vectors, int *axes);

/* Working memory for that many doubles and one more; NULL and an exception without memory. */
double *room_for(Arrays *arrays, Py_ssize_t count);

/* Functions of the module, in wire.c, budget.c, fading.c, motion.c, quadrotor.c, elimination.c, ranking.c, links.c and mean_field/learner.c. */
PyObject *wire_read(PyObject *module, PyObject *args);
PyObject *wire_write(PyObject *module, PyObject *args);
PyObject *motion_move(PyObject *module, PyObject *args);
PyObject *motion_reached(PyObject *module, PyObject *args);
PyObject *quadrotor_fly(PyObject *module, PyObject *args);
PyObject *radio_fade(PyObject *module, PyObject *args);
PyObject *radio_send(PyObject *module, PyObject *args);
PyObject *radio_poisson(PyObject *module, PyObject *args);
PyObject *radio_waves(PyObject *module, PyObject *args);
PyObject *radio_interpolate(PyObject *module, PyObject *args);
PyObject *learner_tables(PyObject *module, PyObject *args);
PyObject *learner_step(PyObject *module, PyObject *args);
PyObject *learner_repel(PyObject *module, PyObject *args);
PyObject *closest_of_all(PyObject *module, PyObject *args);
PyObject *neighbours_of_all(PyObject *module, PyObject *args);
PyObject *links_pick(PyObject *module, PyObject *args);
PyObject *elimination_solve(PyObject *module, PyObject *args);
PyObject *elimination_multiply(PyObject *module, PyObject *args);

#endif
