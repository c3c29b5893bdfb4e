/* Messages as texts with gaps between them: how they are told, measured and written. */
#include "message.h"

#include <string.h>

static int refused(const char *why) {
    PyErr_Format(PyExc_ValueError, "a template %s", why);
    return -1;
}

static int text_in(PyObject *template, Py_ssize_t place, Text *text) {
    char *bytes; /* a tuple keeps it where it is */
    if (PyBytes_AsStringAndSize(PyTuple_GetItem(template, place), &bytes, &text->size) < 0) return -1;
    text->text = bytes;
    return 0;
}

int read_template(PyObject *template, const int *takes, Message *message) {
    if (!PyTuple_Check(template)) return PyErr_SetString(PyExc_TypeError, "a template is a tuple"), -1;
    const Py_ssize_t parts = PyTuple_Size(template);
    if (parts % 2 == 0 || parts > 2 * PIECES - 1) return refused("is texts with gaps between them, and not too many");
    memset(message, 0, sizeof *message);
    for (Py_ssize_t k = 0; k < parts; k += 2) {
        Piece *piece = &message->piece[k / 2];
        piece->gap = GAPS;
        if (text_in(template, k, &piece->text) < 0) return -1;
        message->texts += piece->text.size;
        if (k + 1 == parts) break;
        const long gap = PyLong_AsLong(PyTuple_GetItem(template, k + 1));
        if (gap == -1 && PyErr_Occurred()) return -1;
        if (gap < 0 || gap >= GAPS || !takes[gap]) return refused("has a gap that has no place in it");
        piece->gap = (int)gap;
    }
    return 0;
}

char *gather(Message *message, char *block) {
    Piece *piece = message->piece;
    do {
        memcpy(block, piece->text.text, piece->text.size);
        piece->text.text = block;
        block += piece->text.size;
    } while (piece++->gap != GAPS);
    return block;
}

Text whole(unsigned long long number, char *digits) {
    int size = number < 128 ? 0 : number < 256 ? 1 : number < 65536 ? 2 : number >> 32 == 0 ? 4 : 8;
    if (size == 0) digits[0] = (char)number;
    else digits[0] = (char)(size == 1 ? 0xcc : size == 2 ? 0xcd : size == 4 ? 0xce : 0xcf);
    for (int k = 0; k < size; k++) digits[1 + k] = (char)(number >> 8 * (size - 1 - k));
    return (Text){digits, 1 + size};
}

Py_ssize_t size_of(const Message *message, const Text *gap) {
    Py_ssize_t size = message->texts;
    for (const Piece *piece = message->piece; piece->gap != GAPS; piece++) size += gap[piece->gap].size;
    return size;
}

int told(const Message *message, Text raw, Text *gap) {
    if (raw.size != size_of(message, gap)) return 0; /* what follows stays within */
    const char *at = raw.text;
    for (const Piece *piece = message->piece;; piece++) {
        if (memcmp(at, piece->text.text, piece->text.size)) return 0;
        at += piece->text.size;
        if (piece->gap == GAPS) return 1;
        Text *in = &gap[piece->gap];
        if (piece->gap > NUMBER) in->text = at;
        else if (memcmp(at, in->text, in->size)) return 0;
        at += in->size;
    }
}
