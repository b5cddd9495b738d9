/* See pack.h and rows.h. A token is a byte, or a stretch that repeats what stands a pixel before it. Tokens are
 * gathered block by block and written with the block's own Huffman code. */
#include "pack.h"
#include "rows.h"

#include <stdlib.h>
#include <string.h>

enum {
    BLOCK = 1 << 13, /* tokens */
    SHORTEST = 3, /* stretch, and */
    LONGEST = 258,
    END = 256,
    SYMBOLS = 286,
    TOKENS = END + LONGEST + 1,
    PIXEL = 4, /* bytes, at most */
    DIGIT = 7, /* bits: two hold how often a symbol comes */
    LONGEST_CODE = 15,
    KINDS = 19, /* of symbols that encode the lengths of codes */
    HEADER = 512 /* bytes: more than a block takes beside its tokens */
};

typedef struct {
    uint16_t code[SYMBOLS];
    uint8_t length[SYMBOLS];
} huffman;

typedef struct {
    uint8_t *at;
    uint64_t bits;
    int n;
} stream;

typedef struct {
    stream out;
    const uint8_t *end;
    int pixel; /* bytes */
    uint32_t adler[2];
    int tokens;
    uint16_t token[BLOCK + 1]; /* a byte, or END + the length of a stretch */
} packer;

/* Write n bits, 48 at most: the whole bytes there are, as eight of which the rest is written again. */
static void put(stream *s, uint64_t value, int n) {
    s->bits |= value << s->n;
    s->n += n;
    for (int i = 0; i < 8; i++) s->at[i] = (uint8_t)(s->bits >> (8 * i)); /* one store, where bytes have this order */
    const int whole = s->n >> 3;
    s->at += whole, s->n &= 7, s->bits >>= 8 * whole;
}

static int log2_of(uint32_t v) { return 31 - __builtin_clz(v); }

/* RFC 1951, 3.2.5: a symbol and the bits that follow it. */
typedef struct {
    int symbol, more, bits;
} coded;

static coded length_code(int length) {
    const int l = length - 3;
    if (length == LONGEST) return (coded){285, 0, 0};
    if (l < 8) return (coded){257 + l, 0, 0};
    const int bits = log2_of((uint32_t)l) - 2;
    return (coded){261 + 4 * bits + (l >> bits & 3), l & ((1 << bits) - 1), bits};
}

/* Lengths of Huffman's code, from two queues (van Leeuwen 1976): leaves in order of their weight, and the nodes made of
 * them, which come in order by themselves. Returns the longest. */
static int depth_of_code(const uint32_t *weight, const int16_t *leaf, int leaves, uint8_t *length) {
    uint32_t sum[2 * SYMBOLS];
    int16_t parent[2 * SYMBOLS];
    int depth[2 * SYMBOLS], next_leaf = 0, next_node = leaves, deepest = 0;
    for (int i = 0; i < leaves; i++) sum[i] = weight[leaf[i]];
    for (int node = leaves; node < 2 * leaves - 1; node++) {
        sum[node] = 0;
        for (int k = 0; k < 2; k++) {
            const int from_leaf = next_leaf < leaves && (next_node >= node || sum[next_leaf] <= sum[next_node]);
            const int child = from_leaf ? next_leaf++ : next_node++;
            sum[node] += sum[child], parent[child] = (int16_t)node;
        }
    }
    depth[2 * leaves - 2] = 0;
    for (int i = 2 * leaves - 3; i >= 0; i--) depth[i] = depth[parent[i]] + 1;
    for (int i = 0; i < leaves; i++) {
        length[leaf[i]] = (uint8_t)depth[i];
        if (depth[i] > deepest) deepest = depth[i];
    }
    return deepest;
}

/* Sort the used symbols by weight, stably; return how many there are. */
static int sorted(const uint32_t *weight, int symbols, int16_t *leaf) {
    int16_t other[SYMBOLS];
    int leaves = 0;
    for (int s = 0; s < symbols; s++)
        if (weight[s]) leaf[leaves++] = (int16_t)s;
    for (int shift = 0; shift < 2 * DIGIT; shift += DIGIT) { /* digit by digit, the low one first */
        int from[(1 << DIGIT) + 1] = {0};
        for (int i = 0; i < leaves; i++) from[(weight[leaf[i]] >> shift & ((1 << DIGIT) - 1)) + 1]++;
        for (int d = 0; d < 1 << DIGIT; d++) from[d + 1] += from[d];
        for (int i = 0; i < leaves; i++) other[from[weight[leaf[i]] >> shift & ((1 << DIGIT) - 1)]++] = leaf[i];
        memcpy(leaf, other, (size_t)leaves * sizeof *leaf);
    }
    return leaves;
}

/* Number the codes of each length in order of the symbols (RFC 1951, 3.2.2), turned round: first bits go out first. */
static void number_codes(huffman *h, int symbols) {
    uint32_t next[LONGEST_CODE + 2] = {0};
    for (int s = 0; s < symbols; s++)
        if (h->length[s]) next[h->length[s] + 1]++;
    for (int length = 1; length <= LONGEST_CODE; length++) next[length + 1] = (next[length] + next[length + 1]) << 1;
    for (int s = 0; s < symbols; s++) {
        const int length = h->length[s];
        const uint32_t code = length ? next[length]++ : 0;
        h->code[s] = 0;
        for (int i = 0; i < length; i++) h->code[s] |= (uint16_t)((code >> i & 1) << (length - 1 - i));
    }
}

/* The code of symbols by how often each comes, none longer than `most` bits: weights are evened out until it is so. */
static void find_code(const uint32_t *count, int symbols, int most, huffman *h) {
    int16_t leaf[SYMBOLS];
    uint32_t weight[SYMBOLS];
    memset(h, 0, sizeof *h), memcpy(weight, count, (size_t)symbols * sizeof *weight);
    const int leaves = sorted(weight, symbols, leaf);
    if (leaves == 1) h->length[leaf[0]] = 1;
    while (leaves > 1 && depth_of_code(weight, leaf, leaves, h->length) > most)
        for (int i = 0; i < leaves; i++) weight[leaf[i]] = weight[leaf[i]] / 2 + 1; /* keeps their order */
    number_codes(h, symbols);
}

/* The encoding of a block's codes, 3.2.7: their lengths, with runs of zeros and of repetitions as symbols. */
typedef struct {
    uint8_t word[SYMBOLS + PIXEL], more[SYMBOLS + PIXEL];
    int n;
} telling;

static void tell(const uint8_t *length, int n, telling *t) {
    t->n = 0;
    for (int i = 0, run; i < n; i += run) {
        for (run = 1; i + run < n && length[i + run] == length[i] && run < (length[i] ? 7 : 138);) run++;
        const int word = length[i] ? 16 : run > 10 ? 18 : 17, least = word == 16 ? 4 : 3;
        if (run < least) run = 1;
        if (run == 1 || word == 16) t->word[t->n] = length[i], t->more[t->n++] = 0;
        const int more = word == 18 ? run - 11 : word == 17 ? run - 3 : run - 4;
        if (run > 1) t->word[t->n] = (uint8_t)word, t->more[t->n++] = (uint8_t)more;
    }
}

static int used(const uint8_t *length, int n) {
    while (!length[n - 1]) n--;
    return n;
}

/* The one distance there is, up to 4 bytes, is its own symbol; its code is one bit. */
static void write_code(stream *s, const huffman *code, int distance) {
    static const uint8_t order[KINDS] = {16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15};
    const int n = used(code->length, SYMBOLS);
    uint8_t all[SYMBOLS + PIXEL] = {0}, in_order[KINDS];
    uint32_t count[KINDS] = {0};
    huffman words;
    telling t;
    memcpy(all, code->length, (size_t)n), all[n + distance - 1] = 1;
    tell(all, n + distance, &t);
    for (int i = 0; i < t.n; i++) count[t.word[i]]++;
    find_code(count, KINDS, 7, &words);
    for (int i = 0; i < KINDS; i++) in_order[i] = words.length[order[i]];
    const int kinds = used(in_order, KINDS);
    put(s, (uint64_t)(n - 257), 5), put(s, (uint64_t)(distance - 1), 5), put(s, (uint64_t)(kinds - 4), 4);
    for (int i = 0; i < kinds; i++) put(s, in_order[i], 3);
    for (int i = 0; i < t.n; i++) {
        put(s, words.code[t.word[i]], words.length[t.word[i]]);
        if (t.word[i] > 15) put(s, t.more[i], (int[]){2, 3, 7}[t.word[i] - 16]);
    }
}

/* The bits of a token, and how many, 21 at most. */
typedef struct {
    uint32_t bits;
    int32_t n;
} coding;

static void find_codings(const huffman *code, coding w[TOKENS]) {
    for (int i = 0; i < END; i++) w[i] = (coding){code->code[i], code->length[i]};
    w[END] = (coding){0, 0};
    for (int length = SHORTEST; length <= LONGEST; length++) {
        const coded l = length_code(length);
        const int n = code->length[l.symbol];
        w[END + length] = (coding){code->code[l.symbol] | (uint32_t)l.more << n, n + l.bits + 1}; /* distance: a zero */
    }
}

static void write_tokens(packer *k, const huffman *code) {
    coding w[TOKENS] = {0};
    stream s = k->out;
    find_codings(code, w);
    k->token[k->tokens] = END; /* nothing: tokens are written by twos */
    for (int i = 0; i < k->tokens; i += 2) {
        const coding a = w[k->token[i]], b = w[k->token[i + 1]];
        put(&s, a.bits | (uint64_t)b.bits << a.n, a.n + b.n);
    }
    put(&s, code->code[END], code->length[END]);
    k->out = s;
}

/* How often each symbol comes. */
static void count_symbols(const packer *k, uint32_t count[SYMBOLS]) {
    uint32_t of[TOKENS] = {0};
    for (int i = 0; i < k->tokens; i++) of[k->token[i]]++;
    memset(count, 0, SYMBOLS * sizeof *count), memcpy(count, of, END * sizeof *count);
    for (int length = SHORTEST; length <= LONGEST; length++) count[length_code(length).symbol] += of[END + length];
    count[END] = 1;
}

/* At least as many bytes as the tokens take. */
static int64_t size_of(const uint32_t count[SYMBOLS], const huffman *code) {
    int64_t bits = 0;
    for (int i = 0; i < SYMBOLS; i++) bits += (int64_t)count[i] * (code->length[i] + (i > END ? 6 : 0));
    return bits / 8 + HEADER;
}

/* Write the collected tokens; 0 where there is no room for them. */
static int write_block(packer *k, int last) {
    huffman code;
    uint32_t count[SYMBOLS];
    count_symbols(k, count);
    find_code(count, SYMBOLS, LONGEST_CODE, &code);
    if (k->end - k->out.at < size_of(count, &code)) return 0;
    put(&k->out, (uint64_t)(last | 2 << 1), 3);
    write_code(&k->out, &code, k->pixel);
    write_tokens(k, &code);
    k->tokens = 0;
    return 1;
}

/* Eight bytes, the first the lowest. */
static uint64_t eight(const uint8_t *p) {
    uint64_t v;
    memcpy(&v, p, sizeof v);
    return __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__ ? v : __builtin_bswap64(v);
}

/* Of eight bytes that differ: how many stand before the first that does. */
static int before_first(uint64_t differ) { return __builtin_ctzll(differ) >> 3; }

/* Of eight bytes, the top bit of each that is zero. */
static uint64_t zeros(uint64_t v) {
    const uint64_t low = 0x7F7F7F7F7F7F7F7F;
    return ~(((v & low) + low) | v | low);
}

/* How many bytes are the same, up to `most`, which is at least 1; the seven behind them are looked at too. */
static int same(const uint8_t *a, const uint8_t *b, int most) {
    uint64_t differ = eight(a) ^ eight(b);
    if (most == LONGEST && !differ && !memcmp(a, b, LONGEST)) return LONGEST;
    int i = 0;
    while (!differ && (i += 8) < most) differ = eight(a + i) ^ eight(b + i);
    if (differ) i += before_first(differ);
    return i < most ? i : most;
}

/* Adler's sums (RFC 1950) with n more bytes, 32 at a time. */
static void sum_up(uint32_t adler[2], const uint8_t *p, int64_t n) {
    enum { SAFE = 5536 }; /* bytes, until the second sum no longer fits */
    uint32_t a = adler[0], b = adler[1];
    for (int64_t i = 0; i < n; a %= 65521, b %= 65521) {
        const int64_t to = n - i < SAFE ? n : i + SAFE;
        for (; i + 32 <= to; i += 32) {
            if (!(eight(p + i) | eight(p + i + 8) | eight(p + i + 16) | eight(p + i + 24))) {
                b += 32 * a;
                continue;
            }
            uint32_t sum = 0, weighted = 0;
            for (uint32_t k = 0; k < 32; k++) sum += p[i + k], weighted += (32 - k) * p[i + k];
            b += 32 * a + weighted, a += sum;
        }
        for (; i < to; i++) a += p[i], b += a;
    }
    adler[0] = a, adler[1] = b;
}

/* How many bytes, 6 at most, come before a stretch that repeats what stands a pixel before: the eight are looked at. */
static int unlike(const uint8_t *row, const uint8_t *before) {
    const uint64_t same = zeros(eight(row) ^ eight(before)), three = same & same >> 8 & same >> 16;
    return three ? before_first(three) : 6;
}

/* Collect the tokens of a filtered row of n bytes, preceded by others unless it is the first; 0 where there is no
 * room. */
static int take_row(packer *k, const uint8_t *row, int64_t n, int first) {
    for (int64_t i = 0; i < n;) {
        if (k->tokens > BLOCK - 7 && !write_block(k, 0)) return 0;
        uint16_t *const to = k->token + k->tokens;
        const int sure = first && i < k->pixel ? 1 : n - i < 8 ? 0 : unlike(row + i, row + i - k->pixel);
        if (sure) {
            for (int j = 0; j < 6; j++) to[j] = row[i + j]; /* those that are no such bytes are written again */
            k->tokens += sure, i += sure;
            continue;
        }
        const int run = same(row + i, row + i - k->pixel, (int)(n - i < LONGEST ? n - i : LONGEST));
        *to = (uint16_t)(run < SHORTEST ? row[i] : END + run);
        k->tokens++, i += run < SHORTEST ? 1 : run;
    }
    return 1;
}

/* Filter a row; one of zeros is left as it is, so that runs go on from row to row. */
static void filter(const uint8_t *row, const uint8_t *above, int64_t n, uint8_t *out) {
    out[0] = above ? 2 : 0;
    if (above)
        for (int64_t i = 0; i < n; i++) out[1 + i] = (uint8_t)(row[i] - above[i]);
    else
        memcpy(out + 1, row, (size_t)n);
}

static int64_t finish(packer *k, const uint8_t *out) {
    if (!write_block(k, 1) || k->end - k->out.at < 16) return -1;
    if (k->out.n) put(&k->out, 0, 8 - k->out.n);
    for (int i = 0; i < 4; i++) *k->out.at++ = (uint8_t)((k->adler[1] << 16 | k->adler[0]) >> (24 - 8 * i));
    return k->out.at - out;
}

int64_t cc_pack_room(int64_t row_bytes, int64_t rows) {
    const int64_t bytes = (row_bytes + 1) * rows;
    return 2 * bytes + HEADER * (bytes / BLOCK + 2);
}

int64_t pack_rows(next_row next, const void *picture, int64_t row_bytes, int64_t rows, int32_t pixel_bytes,
                  uint8_t *out, int64_t room) {
    const int64_t n = row_bytes + 1; /* with the filter's own byte */
    packer *k = calloc(1, sizeof *k);
    uint8_t *memory = calloc((size_t)(PIXEL + n + 8 + 2 * row_bytes), 1); /* 8: see `same` */
    int64_t written = -1;
    if (k && memory && room >= HEADER && pixel_bytes <= PIXEL) {
        uint8_t *const filtered = memory + PIXEL; /* behind the end of the one before */
        uint8_t *row = filtered + n + 8, *above = row + row_bytes;
        k->out.at = out, k->end = out + room, k->adler[0] = 1;
        k->pixel = pixel_bytes;
        put(&k->out, 0x0178, 16); /* deflate, a window of 32 kB */
        int64_t y = 0;
        for (; y < rows; y++) {
            const int filled = next(picture, y, row);
            memmove(memory, filtered + n - PIXEL, PIXEL);
            filter(row, filled && y ? above : NULL, row_bytes, filtered);
            sum_up(k->adler, filtered, n);
            if (!take_row(k, filtered, n, !y)) break;
            uint8_t *const before = above;
            above = row, row = before;
        }
        written = y == rows ? finish(k, out) : -1;
    }
    free(k), free(memory);
    return written;
}

typedef struct {
    const uint8_t *pixels;
    int64_t row_bytes;
} bytes;

static int bytes_row(const void *picture, int64_t y, uint8_t *row) {
    const bytes *b = picture;
    memcpy(row, b->pixels + y * b->row_bytes, (size_t)b->row_bytes);
    return row[0] || memcmp(row, row + 1, (size_t)b->row_bytes - 1);
}

int64_t cc_pack(const uint8_t *pixels, int64_t row_bytes, int64_t rows, int32_t pixel_bytes, uint8_t *out,
                int64_t room) {
    const bytes picture = {pixels, row_bytes};
    return pack_rows(bytes_row, &picture, row_bytes, rows, pixel_bytes, out, room);
}
