/* Masks as numbers of files: see layers.h. */
#include "layers.h"

#include <string.h>

/* Index of the first byte, from i on, that differs between the two; n if none does. */
static int64_t differing(const uint8_t *a, const uint8_t *b, int64_t i, int64_t n) {
    for (uint64_t one, other; i + 8 <= n; i += 8) {
        memcpy(&one, a + i, 8), memcpy(&other, b + i, 8);
        if (one != other) break;
    }
    while (i < n && a[i] == b[i]) i++;
    return i;
}

void cc_mask_region(const uint8_t *mask, int32_t width, int32_t height, int64_t found[5]) {
    int64_t count = 0, x0 = width, y0 = height, x1 = -1, y1 = -1;
    for (int64_t y = 0; y < height; y++) {
        const uint8_t *row = mask + y * width;
        const uint8_t *first = memchr(row, 1, (size_t)width);
        if (!first) continue;
        int64_t last = width - 1, in_row = 0;
        while (!row[last]) last--;
        for (int64_t x = first - row; x <= last; x++) in_row += row[x];
        count += in_row;
        x0 = first - row < x0 ? first - row : x0, x1 = last > x1 ? last : x1;
        y0 = y < y0 ? y : y0, y1 = y;
    }
    const int64_t all[5] = {count, count ? x0 : -1, count ? y0 : -1, x1, y1};
    memcpy(found, all, sizeof all);
}

/* Go through all changes, those of a column from top to bottom: count each at first[x + 1], or, with a place to write,
 * put it where first[x] says and move that on. */
static void visit(const uint8_t *mask, int32_t width, int32_t height, int64_t *first, int64_t room, int64_t *at) {
    const uint8_t *bottom = mask + (int64_t)(height - 1) * width;
    for (int64_t y = 0; y < height; y++) {
        const uint8_t *row = mask + y * width, *above = y ? row - width : NULL;
        for (int64_t x = 0; x < width; x++) {
            if (y) x = differing(row, above, x, width);
            if (x >= width || (!y && row[x] == (x ? bottom[x - 1] : 0))) continue;
            if (!at)
                first[x + 1]++;
            else if (first[x]++ < room)
                at[first[x] - 1] = x * height + y;
        }
    }
}

int64_t cc_mask_changes(const uint8_t *mask, int32_t width, int32_t height, int64_t *first, int64_t room, int64_t *at) {
    memset(first, 0, ((size_t)width + 1) * sizeof *first);
    visit(mask, width, height, first, room, NULL);
    for (int64_t x = 0; x < width; x++) first[x + 1] += first[x];
    visit(mask, width, height, first, room, at);
    return first[width];
}
