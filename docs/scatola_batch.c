/* A compact batch as a small box writes it: no allocation, no library but memcpy, on a little endian
 * machine. Prints the first test vector of device-protocol.md; `cc -std=c99 scatola_batch.c` builds it. */
#include <stdint.h>
#include <stdio.h>
#include <string.h>

enum { T_EVEN = 0, T_STEPS16 = 2, T_STEPS32 = 4, V_INT8 = 1, V_INT16 = 2, V_INT32 = 4 };
enum { FX = 1, FY, FZ, WX, WY, WZ, MX, MY, MZ, TEMP, LAT, LON, ALT, SPEED, COURSE, FIX, HDOP, SATS, UTC, BATTERY, IGNITION };

static uint8_t out[1024];
static uint32_t used;

static void put(const void *from, uint32_t size) {   /* what begins next begins at a multiple of 8 */
    memcpy(out + used, from, size);
    used += size;
    while (used % 8) out[used++] = 0;
}

static void header(uint8_t blocks, uint32_t ticks_per_s) {
    const uint8_t start[8] = {'S', 'C', 'T', 'B', 1, blocks, 0, 0};
    const uint32_t rest[2] = {0 /* the length, see finish() */, ticks_per_s};
    put(start, 8);
    put(rest, 8);
}

static void block(uint32_t rows, uint8_t columns, uint8_t time_kind, int64_t first_tick, uint32_t step) {
    const uint8_t kinds[4] = {columns, time_kind, 0, 0};
    const uint32_t last[2] = {step, 0};
    uint8_t begin[8];
    memcpy(begin, &rows, 4);
    memcpy(begin + 4, kinds, 4);
    put(begin, 8);
    put(&first_tick, 8);
    put(last, 8);
}

static void column(uint8_t number, uint8_t type, double scale, double offset) {
    const uint8_t kinds[8] = {number, type, 0, 0, 0, 0, 0, 0};
    put(kinds, 8);
    put(&scale, 8);
    put(&offset, 8);
}

static void finish(void) {
    const uint32_t length = used + 4;
    uint32_t crc = 0xFFFFFFFFu;
    memcpy(out + 8, &length, 4);
    for (uint32_t i = 0; i < used; i++) {
        crc ^= out[i];
        for (int bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
    }
    crc = ~crc;
    memcpy(out + used, &crc, 4);
    used += 4;
}

int main(void) {
    /* Four samples at 200 Hz from 12.5 s after boot, in thousandths of m/s2; y was not sampled the last time,
     * so neither are x and z: INT16_MIN says so. */
    const int16_t fx[] = {110, 120, 100, INT16_MIN}, fy[] = {20, 10, 30, INT16_MIN}, fz[] = {-9800, -9810, -9790, INT16_MIN};
    const int16_t temp[] = {2150, INT16_MIN, INT16_MIN, 2151};
    /* Two fixes, 250 ms apart, the first 12.504 s after boot. */
    const uint16_t steps[] = {0, 250};
    const int32_t lat[] = {454070000, 454070313}, lon[] = {118770000, 118770000};
    const int16_t speed[] = {1390, 1400};
    const int8_t fix[] = {1, 1};

    header(2, 1000);
    block(4, 4, T_EVEN, 12500, 5);
    column(FX, V_INT16, 0.001, 0.0);
    column(FY, V_INT16, 0.001, 0.0);
    column(FZ, V_INT16, 0.001, 0.0);
    column(TEMP, V_INT16, 0.01, 0.0);
    put(fx, sizeof fx);
    put(fy, sizeof fy);
    put(fz, sizeof fz);
    put(temp, sizeof temp);
    block(2, 4, T_STEPS16, 12504, 0);
    column(LAT, V_INT32, 1e-7, 0.0);
    column(LON, V_INT32, 1e-7, 0.0);
    column(SPEED, V_INT16, 0.01, 0.0);
    column(FIX, V_INT8, 1.0, 0.0);
    put(steps, sizeof steps);
    put(lat, sizeof lat);
    put(lon, sizeof lon);
    put(speed, sizeof speed);
    put(fix, sizeof fix);
    finish();
    for (uint32_t i = 0; i < used; i++) printf("%02x%s", out[i], i % 32 == 31 ? "\n" : "");
    printf("\n");
    return 0;
}
