/* Messages as texts with gaps between them (swarm.plain.Plain.template): how they are told, measured and written. */
#ifndef MEANFLOCK_MESSAGE_H
#define MEANFLOCK_MESSAGE_H

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>

/* What a gap is for; the first two as swarm/plain.py numbers them, the others as agent/kernel.py does. */
enum { TICK, NUMBER, STATES, MODELS, OUTCOME, SOURCE, REPORT, GAPS };

enum { PIECES = 8, WIDEST = 9 }; /* of a message, at most; bytes of a whole number, at most */

typedef struct { const char *text; Py_ssize_t size; } Text;

/* A text and the gap after it; after the last there is none: GAPS. */
typedef struct { Text text; int gap; } Piece;

typedef struct {
    Py_ssize_t texts; /* bytes of them */
    Piece piece[PIECES];
} Message;

/* Messages of a template, (text, gap, …, text), whose gaps are among those that it `takes`; or −1 and an error. The
 * texts are the template's. */
int read_template(PyObject *template, const int *takes, Message *message);

/* Copies the texts to `block`, one behind the other, so that fewer lines of a cache hold them; returns where they
 * end. */
char *gather(Message *message, char *block);

/* A whole number as MessagePack has it, in as few bytes as it takes: at most WIDEST, which are returned. */
Text whole(unsigned long long number, char *digits);

/* Whether `raw` is such a message with the TICK and the NUMBER of `gap`, and other gaps of the sizes there; if so, what
 * is in those is where `gap` says. */
int told(const Message *message, Text raw, Text *gap);

/* In bytes, with gaps of these sizes. */
Py_ssize_t size_of(const Message *message, const Text *gap);

#endif
