/* Compiled form of kernels/wire.py: reader and writer of tick messages, with the same signatures, results and reasons. */
#include "module.h"

#include <stdint.h>
#include <string.h>

enum { SENSE = 1, ACT = 2, HEAD = 19, BATCH = 13, NAME = 4, LINK = 8, MOST_TABLES = 7 };
enum { ARRAY = 0x90, U32 = 0xce, BIN32 = 0xc6, ARRAY16 = 0xdc, SMALL = 127, BATCH_ITEMS = 7, COUNTED = 0xffff };

static const int ITEM[] = {2, 4, 8, 4, 1, 2, 1}; /* bytes of "<f2", "<f4", "<f8", "<i4", "u1", "<i2", "i1" */
enum { DTYPES = sizeof ITEM / sizeof *ITEM, FLOATS = 3 };

/* Types of the tables: b bytes, i int32, d float64; NULL for an unknown message. */
static const char *tables_of(unsigned long type) { return type == SENSE ? "db" : type == ACT ? "diiiidb" : NULL; }

/* Bytes of a number of a table. */
static int item_of(char letter) { return letter == 'd' ? 8 : letter == 'i' ? 4 : 1; }

/* The rest of a message. `fault`: the reason to refuse it if it is well-formed; NULL for none. */
typedef struct {
    const unsigned char *at, *end;
    const char *fault;
} Reader;

typedef struct {
    const char *at;
    uint64_t size;
} Bytes;

static uint32_t number_at(const unsigned char *at) {
    return (uint32_t)at[0] << 24 | (uint32_t)at[1] << 16 | (uint32_t)at[2] << 8 | at[3];
}

static PyObject *refuse(const char *why) { return PyErr_SetString(PyExc_ValueError, why), NULL; }

/* Defines a function that returns whether all numbers in `size` bytes, perhaps unaligned, are finite. Its loop has no
   early end, so that compilers vectorise it. */
#define ALL_FINITE(name, word, infinite)                                    \
    static int name(const char *at, uint64_t size) {                        \
        word beyond = 0;                                                    \
        for (uint64_t i = 0; i + sizeof(word) <= size; i += sizeof(word)) { \
            word bits;                                                      \
            memcpy(&bits, at + i, sizeof bits);                             \
            beyond |= (word)((word)(bits & (infinite)) == (infinite));      \
        }                                                                   \
        return !beyond;                                                     \
    }
ALL_FINITE(all_finite_16, uint16_t, 0x7c00)
ALL_FINITE(all_finite_32, uint32_t, 0x7f800000)
ALL_FINITE(all_finite_64, uint64_t, 0x7ff0000000000000)

/* Returns whether `size` bytes are finite floats of 2, 4 or 8 bytes each. */
static int all_finite(const char *at, uint64_t size, int item) {
    return item == 8 ? all_finite_64(at, size) : item == 4 ? all_finite_32(at, size) : all_finite_16(at, size);
}

/* Notes a fault in what is well-formed: the first of its sizes and names, else the first of its numbers. */
static void note(Reader *in, const char *why) {
    if (in->fault == NULL || (in->fault[0] == 'n' && why[0] == 'w')) in->fault = why;
}

static void check_finite(Reader *in, Bytes floats, int item) {
    if (!all_finite(floats.at, floats.size, item)) note(in, "non-finite: a number is not finite");
}

/* Reads a byte string; returns 0 and sets an error if there is none. */
static int bytes_next(Reader *in, Bytes *found) {
    if (in->end - in->at < 5 || in->at[0] != BIN32 || (size_t)(in->end - in->at - 5) < number_at(in->at + 1))
        return refuse("malformed: not a byte string of that length"), 0;
    found->size = number_at(in->at + 1);
    found->at = (const char *)in->at + 5;
    in->at += 5 + found->size;
    return 1;
}

/* Whether `count` numbers, `step` apart, are 0 … `end` − 1; they begin anywhere. */
static int all_below(const char *at, uint64_t count, size_t step, uint64_t end) {
    int within = 1;
    for (uint64_t i = 0; i < count; i++, at += step * sizeof(int32_t)) {
        int32_t number;
        memcpy(&number, at, sizeof number);
        within &= number >= 0 && (uint64_t)number < end;
    }
    return within;
}

/* Whether the byte strings of a batch, each below 4 GiB, have the sizes that its numbers say. */
static int batch_fits(uint64_t code, uint64_t width, uint64_t source, uint64_t payload, uint64_t links) {
    const uint64_t sources = source / NAME;
    return code < DTYPES && source % NAME == 0 && links % LINK == 0 && (!width || sources <= UINT32_MAX / width)
        && payload == sources * width * ITEM[code];
}

/* `uavs`: number of all UAVs, to check what the batch names; 0: unchecked. */
static PyObject *batch_next(Reader *in, uint32_t uavs) {
    const unsigned char *head = in->at;
    if (in->end - in->at < BATCH) return refuse("malformed: cut off");
    const unsigned kind = head[1], code = head[7];
    if (head[0] != (ARRAY | BATCH_ITEMS) || kind > SMALL || head[2] != U32 || code > SMALL || head[8] != U32)
        return refuse("malformed: not the head of a batch");
    const uint32_t number = number_at(head + 3), width = number_at(head + 9);
    in->at += BATCH;
    Bytes source, payload, links;
    if (!bytes_next(in, &source) || !bytes_next(in, &payload) || !bytes_next(in, &links)) return NULL;
    const uint64_t sources = source.size / NAME, pairs = links.size / LINK;
    if (!batch_fits(code, width, source.size, payload.size, links.size))
        note(in, "wrong-shape: no such dtype, or byte strings of other sizes");
    else if (uavs && !(all_below(source.at, sources, 1, uavs) && all_below(links.at, pairs, 2, sources)
                       && all_below(links.at + NAME, pairs, 2, uavs)))
        note(in, "wrong-shape: UAVs or rows that are not there");
    else if (code < FLOATS) check_finite(in, payload, ITEM[code]);
    return Py_BuildValue("IIIIy#y#y#", kind, (unsigned)number, code, (unsigned)width, source.at, (Py_ssize_t)source.size,
                         payload.at, (Py_ssize_t)payload.size, links.at, (Py_ssize_t)links.size);
}

static PyObject *batches_of(Reader *in, uint32_t uavs) {
    if (in->end - in->at < 3) return refuse("malformed: cut off");
    if (in->at[0] != ARRAY16) return refuse("malformed: not an array of frames");
    const int count = in->at[1] << 8 | in->at[2];
    in->at += 3;
    PyObject *batches = PyTuple_New(count);
    for (int k = 0; batches != NULL && k < count; k++) {
        PyObject *batch = batch_next(in, uavs);
        if (batch == NULL) Py_CLEAR(batches);
        else PyTuple_SetItem(batches, k, batch);
    }
    if (batches != NULL && in->at != in->end) {
        Py_CLEAR(batches);
        return refuse("malformed: more than a message");
    }
    return batches;
}

/* Copies a first table of float64 to the caller's array; returns 0 and sets an error if its shape differs. */
static int copy_table(PyObject *into, const char *table, uint32_t rows, uint32_t columns) {
    Py_buffer view;
    if (PyObject_GetBuffer(into, &view, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | PyBUF_WRITABLE) < 0) return 0;
    const int fits = view.ndim == 2 && view.format != NULL && strcmp(view.format, "d") == 0
        && view.shape[0] == (Py_ssize_t)rows && (!rows || view.shape[1] == (Py_ssize_t)columns);
    if (fits && view.len) memcpy(view.buf, table, (size_t)view.len);
    PyBuffer_Release(&view);
    if (!fits) refuse("wrong-shape: a first table of other rows or columns than expected");
    return fits;
}

PyObject *wire_read(PyObject *module, PyObject *args) {
    char *text;
    Py_ssize_t length;
    int kind = 0;
    unsigned uavs = 0;
    PyObject *raw, *into = Py_None, *batches = NULL, *result = NULL;
    if (!PyArg_ParseTuple(args, "O|iOI:read", &raw, &kind, &into, &uavs)
        || PyBytes_AsStringAndSize(raw, &text, &length) < 0)
        return NULL;
    const unsigned char *head = (const unsigned char *)text;
    const char *letters = length < HEAD ? NULL : tables_of(head[1]);
    const size_t count = letters == NULL ? 0 : strlen(letters);
    if (letters == NULL || head[0] != (ARRAY | (7 + count)) || head[2] != U32 || head[7] != U32 || head[12] > SMALL
        || head[13] != U32 || head[18] > SMALL)
        return refuse("malformed: not the head of a tick message");
    const uint32_t run = number_at(head + 3), tick = number_at(head + 8), rows = number_at(head + 14);
    const unsigned type = head[1], flags = head[12], columns = head[18];
    Reader in = {head + HEAD, head + length, NULL};
    Bytes table[MOST_TABLES];
    PyObject *others = PyTuple_New((Py_ssize_t)count - 1);
    for (size_t k = 0; k < count; k++) {
        if (others == NULL || !bytes_next(&in, &table[k])) goto done;
        const int item = item_of(letters[k]);
        if (table[k].size % item || (!k && table[k].size != 8 * (uint64_t)rows * columns))
            note(&in, "wrong-shape: a table of another size");
        else if (item == 8) check_finite(&in, table[k], item);
        PyObject *bytes = k ? PyBytes_FromStringAndSize(table[k].at, (Py_ssize_t)table[k].size) : NULL;
        if (k && (bytes == NULL || PyTuple_SetItem(others, (Py_ssize_t)k - 1, bytes) < 0)) goto done;
    }
    if ((batches = batches_of(&in, uavs)) == NULL) goto done;
    if (in.fault == NULL && kind && kind != (int)type) in.fault = "wrong-kind: a message of the other type";
    if (in.fault != NULL) refuse(in.fault);
    else if (into == Py_None || copy_table(into, table[0].at, rows, columns))
        result = Py_BuildValue("IIIIIIy#OO", type, (unsigned)run, (unsigned)tick, flags, (unsigned)rows, columns,
                               table[0].at, (Py_ssize_t)table[0].size, others, batches);
done:
    Py_XDECREF(others);
    Py_XDECREF(batches);
    return result;
}

/* ---- Writing ---- */

static unsigned char *put_number(unsigned char *at, unsigned mark, uint64_t number) {
    const unsigned char bytes[] = {mark, number >> 24 & 255, number >> 16 & 255, number >> 8 & 255, number & 255};
    memcpy(at, bytes, sizeof bytes);
    return at + sizeof bytes;
}

static unsigned char *put_bytes(unsigned char *at, const Py_buffer *view) {
    at = put_number(at, BIN32, (uint64_t)view->len);
    if (view->len) memcpy(at, view->buf, (size_t)view->len);
    return at + view->len;
}

enum { SOURCE, PAYLOAD, LINKS, PARTS };
typedef struct { unsigned long kind, number, code, width; Py_buffer part[PARTS]; } Out;

/* Buffers to release. */
static void release(Py_buffer *view, int held) {
    while (held--) PyBuffer_Release(&view[held]);
}

static int fits(unsigned long number, unsigned long most) {
    if (number <= most) return 1;
    return PyErr_SetString(PyExc_ValueError, "wrong-shape: a number beyond its place in the layout"), 0;
}

/* Prepares a batch to be written; returns -1, sets an error and holds no buffer if it does not fit. */
static int take_batch(PyObject *batch, Out *out) {
    PyObject *array[PARTS];
    int held = 0;
    if (!PyTuple_Check(batch)) return PyErr_SetString(PyExc_TypeError, "a batch is a tuple"), -1;
    if (!PyArg_ParseTuple(batch, "kkkkOOO:batch", &out->kind, &out->number, &out->code, &out->width, &array[SOURCE],
                          &array[PAYLOAD], &array[LINKS]))
        return -1;
    if (!fits(out->kind, SMALL) || !fits(out->number, UINT32_MAX) || !fits(out->width, UINT32_MAX)) return -1;
    for (; held < PARTS; held++)
        if (PyObject_GetBuffer(array[held], &out->part[held], PyBUF_C_CONTIGUOUS) < 0) return release(out->part, held), -1;
    const uint64_t source = out->part[SOURCE].len, payload = out->part[PAYLOAD].len, links = out->part[LINKS].len;
    if ((source | payload | links) <= UINT32_MAX && batch_fits(out->code, out->width, source, payload, links)) return 0;
    PyErr_SetString(PyExc_ValueError, "wrong-shape: no such dtype, or byte strings of other sizes");
    return release(out->part, PARTS), -1;
}

PyObject *wire_write(PyObject *module, PyObject *args) {
    unsigned long type, run, tick, flags, rows, columns;
    PyObject *first, *tables, *frames = NULL, *result = NULL, *sequence = NULL;
    Py_buffer view[MOST_TABLES];
    Out *out = NULL;
    int held = 0;
    Py_ssize_t batches = 0;
    if (!PyArg_ParseTuple(args, "kkkkkkOO!|O:write", &type, &run, &tick, &flags, &rows, &columns, &first, &PyTuple_Type,
                          &tables, &frames))
        return NULL;
    const char *letters = tables_of(type);
    const int count = letters == NULL ? 0 : (int)strlen(letters);
    if (letters == NULL || PyTuple_Size(tables) != count - 1) return refuse("wrong-shape: no such type, or other tables");
    if (!fits(run, UINT32_MAX) || !fits(tick, UINT32_MAX) || !fits(rows, UINT32_MAX) || !fits(flags, SMALL)
        || !fits(columns, SMALL))
        return NULL;
    size_t size = HEAD + 3;
    while (held < count) {
        PyObject *table = held ? PyTuple_GetItem(tables, held - 1) : first;
        if (PyObject_GetBuffer(table, &view[held], PyBUF_C_CONTIGUOUS) < 0) goto done;
        const uint64_t bytes = (uint64_t)view[held++].len;
        if (bytes > UINT32_MAX || bytes % item_of(letters[held - 1]) || (held == 1 && bytes != 8 * (uint64_t)rows * columns)) {
            refuse("wrong-shape: a table of another size");
            goto done;
        }
        size += bytes + 5;
    }
    if (frames != NULL && (sequence = PySequence_Tuple(frames)) == NULL) goto done;
    const Py_ssize_t wanted = sequence == NULL ? 0 : PyTuple_Size(sequence);
    if (!fits((unsigned long)wanted, COUNTED)) goto done;
    if (wanted && (out = PyMem_Calloc((size_t)wanted, sizeof *out)) == NULL) {
        PyErr_NoMemory();
        goto done;
    }
    for (; batches < wanted; batches++) {
        if (take_batch(PyTuple_GetItem(sequence, batches), &out[batches]) < 0) goto done;
        size += BATCH;
        for (int k = 0; k < PARTS; k++) size += (size_t)out[batches].part[k].len + 5;
    }
    if ((result = PyBytes_FromStringAndSize(NULL, (Py_ssize_t)size)) == NULL) goto done;
    unsigned char *at = (unsigned char *)PyBytes_AsString(result);
    *at++ = (unsigned char)(ARRAY | (7 + count));
    *at++ = (unsigned char)type;
    at = put_number(at, U32, run);
    at = put_number(at, U32, tick);
    *at++ = (unsigned char)flags;
    at = put_number(at, U32, rows);
    *at++ = (unsigned char)columns;
    for (int k = 0; k < count; k++) at = put_bytes(at, &view[k]);
    *at++ = ARRAY16;
    *at++ = (unsigned char)(wanted >> 8);
    *at++ = (unsigned char)(wanted & 255);
    for (Py_ssize_t k = 0; k < wanted; k++) {
        *at++ = ARRAY | BATCH_ITEMS;
        *at++ = (unsigned char)out[k].kind;
        at = put_number(at, U32, out[k].number);
        *at++ = (unsigned char)out[k].code;
        at = put_number(at, U32, out[k].width);
        for (int part = 0; part < PARTS; part++) at = put_bytes(at, &out[k].part[part]);
    }
done:
    for (Py_ssize_t k = 0; k < batches; k++) release(out[k].part, PARTS);
    PyMem_Free(out);
    release(view, held);
    Py_XDECREF(sequence);
    return result;
}
