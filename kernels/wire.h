/* The functions of kernels/wire.c, as the module has them. */
#ifndef MEANFLOCK_WIRE_H
#define MEANFLOCK_WIRE_H

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>

PyObject *wire_read(PyObject *module, PyObject *args);
PyObject *wire_write(PyObject *module, PyObject *args);

#endif
