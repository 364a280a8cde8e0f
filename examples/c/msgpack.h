/* As much of msgpack as the bus needs: maps of numbers, texts and lists. */
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

typedef struct {
    uint8_t bytes[1024]; /* No message of a direct controller with an empty `missing` is longer. */
    size_t size;
} mp_writer;

/* A byte, and after it an integer of so many bytes. */
static inline void mp_put(mp_writer *out, uint8_t head, uint64_t value, int bytes) {
    out->bytes[out->size++] = head;
    while (bytes > 0) out->bytes[out->size++] = (uint8_t)(value >> (8 * --bytes));
}

static inline void mp_text(mp_writer *out, const char *text) {
    size_t size = strlen(text);
    mp_put(out, 0xd9, size, 1);
    memcpy(out->bytes + out->size, text, size);
    out->size += size;
}

static inline void mp_integer(mp_writer *out, const char *name, int64_t value) {
    mp_text(out, name);
    mp_put(out, 0xd3, (uint64_t)value, 8);
}

static inline void mp_number(mp_writer *out, const char *name, double value) {
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    mp_text(out, name);
    mp_put(out, 0xcb, bits, 8);
}

typedef enum { MP_BAD, MP_NIL, MP_INTEGER, MP_NUMBER, MP_TEXT, MP_LIST, MP_MAP } mp_kind;

typedef struct {
    mp_kind kind;
    uint64_t size;    /* Bytes of a text; entries of a list or map, which follow. */
    int64_t integer;  /* Of an integer. */
    double number;    /* Of a number or an integer. */
    const char *text; /* Of a text; no zero ends it. */
} mp_item;

typedef struct {
    const uint8_t *at, *end;
} mp_reader;

/* Read one item. What no message holds, such as a single-precision number, is bad. */
static inline mp_item mp_read(mp_reader *in) {
    static const uint8_t kinds[] = { /* 0xc0 to 0xdf */
        MP_NIL, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, MP_NUMBER, MP_INTEGER, MP_INTEGER, MP_INTEGER, MP_INTEGER,
        MP_INTEGER, MP_INTEGER, MP_INTEGER, MP_INTEGER, 0, 0, 0, 0, 0, MP_TEXT, MP_TEXT, 0, MP_LIST, 0, MP_MAP};
    static const uint8_t bytes[] = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 8, 1, 2, 4, 8,
                                    1, 2, 4, 8, 0, 0, 0, 0, 0, 1, 2, 0, 2, 0, 2, 0};
    uint8_t head = in->at < in->end ? *in->at++ : 0xc1;
    mp_item item = {.integer = (int8_t)head};
    if (head < 0x80 || head >= 0xe0) {
        item.kind = MP_INTEGER;
    } else if (head < 0xc0) {
        item.kind = head < 0x90 ? MP_MAP : head < 0xa0 ? MP_LIST : MP_TEXT;
        item.size = head & (head < 0xa0 ? 15 : 31);
    } else {
        uint64_t value = 0;
        int left = bytes[head - 0xc0], unused = head < 0xd0 ? 0 : 64 - 8 * left;
        if (in->end - in->at < left) return (mp_item){.kind = MP_BAD};
        while (left-- > 0) value = value << 8 | *in->at++;
        item.kind = (mp_kind)kinds[head - 0xc0];
        item.size = value;
        if (item.kind == MP_INTEGER) item.integer = (int64_t)(value << unused) >> unused;
        if (item.kind == MP_NUMBER) memcpy(&item.number, &value, sizeof value);
    }
    if (item.kind == MP_INTEGER) item.number = (double)item.integer;
    if (item.kind == MP_TEXT) {
        if (item.size > (uint64_t)(in->end - in->at)) return (mp_item){.kind = MP_BAD};
        item.text = (const char *)in->at;
        in->at += item.size;
    }
    return item;
}

/* Pass over the entries of a list or map that was read; false: there are fewer than it says. */
static inline bool mp_skip(mp_reader *in, mp_item item) {
    for (uint64_t left = 1;; item = mp_read(in)) {
        if (item.kind == MP_BAD) return false;
        left += item.kind == MP_MAP ? 2 * item.size : item.kind == MP_LIST ? item.size : 0;
        if (--left == 0) return true;
    }
}
