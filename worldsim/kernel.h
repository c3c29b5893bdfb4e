/* The functions of the module, by file. */
#ifndef MEANFLOCK_WORLD_KERNEL_H
#define MEANFLOCK_WORLD_KERNEL_H

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>

/* said.c */
PyObject *enter(PyObject *module, PyObject *args);

/* measured.c */
PyObject *distances_of(PyObject *module, PyObject *columns);
PyObject *near_of(PyObject *module, PyObject *args);
PyObject *spread_of(PyObject *module, PyObject *args);

/* kernel.c: whether a view holds so many doubles; an error if not. */
int holds(const Py_buffer *view, Py_ssize_t count);

#endif
