/* Calls each function of the interface with valid and invalid arguments. Prints "ok". */
#include <plumbline_ahrs.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CHECK(condition)                                                                           \
    do {                                                                                           \
        if (!(condition)) {                                                                        \
            printf("line %d: %s; newest error: %s\n", __LINE__, #condition,                        \
                   plumbline_error_message());                                                     \
            exit(1);                                                                               \
        }                                                                                          \
    } while (0)
#define CHECK_STATUS(call, status) CHECK((call) == PLUMBLINE_STATUS_##status)

/* Replacements of the allocation functions. They count the allocations. */
static long allocations = 0;
extern
#ifdef __cplusplus
    "C"
#endif
    void *__libc_malloc(size_t size);
#ifdef __cplusplus
extern "C"
#endif
    void *malloc(size_t size)
#ifdef __cplusplus
        throw()
#endif
{
    allocations++;
    return __libc_malloc(size);
}

static const double ZERO[3] = {0.0, 0.0, 0.0}, UP[3] = {0.0, 0.0, 9.81}, FIELD[3] = {0.0, 20.0, -40.0};
static const double ONE[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, SINGULAR[9] = {1, 0, 0, 1, 0, 0, 0, 0, 1};

static void check_builder(void) {
    PlumblineBuilder *b = plumbline_builder_new();
    PlumblineParameter parameter;
    size_t count;
    CHECK(b != NULL);
    CHECK_STATUS(plumbline_builder_sample_rate_hz(b, 200.0), OK);
    CHECK_STATUS(plumbline_builder_gyro_range_deg_s(b, 500.0), OK);
    CHECK_STATUS(plumbline_builder_accel_range_g(b, 8.0), OK);
    CHECK_STATUS(plumbline_builder_mag_range_ut(b, 400.0), OK);
    CHECK_STATUS(plumbline_builder_gap_s(b, 0.2), OK);
    CHECK_STATUS(plumbline_builder_frozen_after_s(b, 1.0), OK);
    CHECK_STATUS(plumbline_builder_declination_deg(b, 4.5), OK);
    CHECK_STATUS(plumbline_builder_gyro_samples(b, PLUMBLINE_GYRO_SAMPLES_INSTANT), OK);
    CHECK_STATUS(plumbline_builder_gyro_samples(b, 2), INVALID_ARGUMENT);
    CHECK_STATUS(plumbline_builder_axes(b, PLUMBLINE_BODY_FRD), OK);
    CHECK_STATUS(plumbline_builder_axes(b, 3), INVALID_ARGUMENT);
    CHECK_STATUS(plumbline_builder_mounting(b, ONE), OK);
    CHECK_STATUS(plumbline_builder_mounting(b, SINGULAR), INVALID_CALIBRATION);
    CHECK_STATUS(plumbline_builder_mounting(b, NULL), NULL_POINTER);
    CHECK_STATUS(plumbline_builder_calibration(b, PLUMBLINE_SENSOR_MAG, ONE, ZERO), OK);
    CHECK_STATUS(plumbline_builder_calibration(b, PLUMBLINE_SENSOR_MAG, SINGULAR, ZERO), INVALID_CALIBRATION);
    CHECK_STATUS(plumbline_builder_calibration(b, 3, ONE, ZERO), INVALID_ARGUMENT);

    CHECK_STATUS(plumbline_builder_accel_range_g(b, NAN), OUT_OF_RANGE);
    CHECK(strstr(plumbline_error_message(), "0.1 to 10000") != NULL);
    CHECK_STATUS(plumbline_builder_set_stage(b, PLUMBLINE_SLOT_FUSER, "wzz"), NOT_FOUND);
    CHECK(strstr(plumbline_error_message(), "multiple-model, wz,") != NULL);
    CHECK_STATUS(plumbline_builder_set_stage(b, PLUMBLINE_SLOT_FUSER, "\xff"), INVALID_ARGUMENT);
    CHECK_STATUS(plumbline_builder_set_stage(b, 4, "wz"), INVALID_ARGUMENT);
    CHECK_STATUS(plumbline_builder_set_stage(b, PLUMBLINE_SLOT_GYRO, "mobius-coning"), OK);
    CHECK_STATUS(plumbline_builder_set_stage(b, PLUMBLINE_SLOT_COURSE, "track"), OK);
    CHECK_STATUS(plumbline_builder_set_stage(b, PLUMBLINE_SLOT_FUSER, "wz"), OK);
    count = plumbline_builder_parameter_count(b, PLUMBLINE_SLOT_FUSER);
    CHECK(count > 0);
    CHECK_STATUS(plumbline_builder_parameter_at(b, PLUMBLINE_SLOT_FUSER, count - 1, &parameter), OK);
    CHECK_STATUS(plumbline_builder_parameter_at(b, PLUMBLINE_SLOT_FUSER, count, &parameter), NOT_FOUND);
    CHECK_STATUS(plumbline_builder_set_parameter(b, PLUMBLINE_SLOT_FUSER, parameter.name, parameter.max), OK);
    CHECK_STATUS(plumbline_builder_set_parameter(b, PLUMBLINE_SLOT_FUSER, parameter.name, -HUGE_VAL), OUT_OF_RANGE);
    CHECK_STATUS(plumbline_builder_set_parameter(b, PLUMBLINE_SLOT_FUSER, "x", 1.0), NOT_FOUND);
    CHECK_STATUS(plumbline_builder_gap_s(NULL, 0.1), NULL_POINTER);
    CHECK(strcmp(plumbline_error_message(), "builder is null") == 0);
    plumbline_builder_free(b);
    plumbline_builder_free(NULL);
}

int main(void) {
    PlumblineAhrs *ahrs = NULL, *other;
    PlumblineAttitude attitude, restored;
    PlumblineFix fix = {{0.0, 0.0, 0.0}, NAN, NAN, 0.8};
    char text[64], *memory, *place;
    void *snapshot;
    size_t size = plumbline_ahrs_size(), align = plumbline_ahrs_align();
    long before;
    int i;

    CHECK(strlen(plumbline_error_message()) == 0);
    CHECK(strcmp(plumbline_status_text(PLUMBLINE_STATUS_OK), "success") == 0);
    CHECK(strcmp(plumbline_status_text(99), "unknown status") == 0);
    check_builder();

    memory = (char *)malloc(size + align);
    place = memory + (align - (uintptr_t)memory % align) % align;
    CHECK_STATUS(plumbline_ahrs_init(NULL, place, size - 1, &ahrs), INVALID_MEMORY);
    CHECK_STATUS(plumbline_ahrs_init(NULL, place + 1, size, &ahrs), INVALID_MEMORY);
    CHECK_STATUS(plumbline_ahrs_init(NULL, NULL, size, &ahrs), NULL_POINTER);
    CHECK_STATUS(plumbline_ahrs_init(NULL, place, size, &ahrs), OK);
    before = allocations;
    other = plumbline_ahrs_new(NULL);
    CHECK(other != NULL);
    CHECK(allocations > before); /* The library's allocations are counted. */
    snapshot = malloc(plumbline_ahrs_snapshot_size(ahrs));

    before = allocations;
    for (i = 0; i < 400; i++) {
        double wobble[3] = {0.0, 0.0, 0.0};
        wobble[i % 3] = 1e-4 * (i % 7);
        CHECK_STATUS(plumbline_ahrs_update_mag(ahrs, FIELD), OK);
        CHECK_STATUS(plumbline_ahrs_update_gnss(ahrs, &fix), OK);
        CHECK_STATUS(plumbline_ahrs_update(ahrs, wobble, UP, NULL, 0.01, &attitude), OK);
    }
    CHECK((attitude.flags & PLUMBLINE_FLAG_UNALIGNED) == 0);
    CHECK((attitude.flags & PLUMBLINE_FLAG_FORCE_STUCK) != 0);
    CHECK(fabs(attitude.pitch_rad) < 1e-3 && attitude.heading_reference == PLUMBLINE_HEADING_REFERENCE_MAGNETIC);
    CHECK(plumbline_flags_text(PLUMBLINE_FLAG_GAP, text, sizeof text) == 3 && strcmp(text, "gap") == 0);

    CHECK_STATUS(plumbline_ahrs_save(ahrs, snapshot, 16), INVALID_MEMORY);
    CHECK_STATUS(plumbline_ahrs_save(ahrs, snapshot, plumbline_ahrs_snapshot_size(ahrs)), OK);
    CHECK_STATUS(plumbline_ahrs_restore(other, snapshot, 16), INVALID_SNAPSHOT);
    CHECK_STATUS(plumbline_ahrs_restore(other, snapshot, plumbline_ahrs_snapshot_size(ahrs)), OK);
    CHECK_STATUS(plumbline_ahrs_update_at(ahrs, ZERO, UP, NULL, attitude.t_ns + 10000000, NULL), OK);
    CHECK_STATUS(plumbline_ahrs_update(other, ZERO, UP, NULL, 0.01, NULL), OK);
    CHECK_STATUS(plumbline_ahrs_attitude(ahrs, PLUMBLINE_FRAME_NED_FRD, &attitude), OK);
    CHECK_STATUS(plumbline_ahrs_attitude(other, PLUMBLINE_FRAME_NED_FRD, &restored), OK);
    CHECK(memcmp(attitude.quaternion, restored.quaternion, sizeof attitude.quaternion) == 0);
    CHECK(attitude.tick == restored.tick);

    CHECK_STATUS(plumbline_ahrs_update_at(ahrs, ZERO, UP, FIELD, attitude.t_ns, NULL), OK);
    CHECK(plumbline_ahrs_rejected(ahrs) == 1);
    CHECK_STATUS(plumbline_ahrs_update(ahrs, NULL, UP, NULL, 0.01, NULL), NULL_POINTER);
    CHECK_STATUS(plumbline_ahrs_update_mag(NULL, FIELD), NULL_POINTER);
    CHECK_STATUS(plumbline_ahrs_attitude(ahrs, 4, &attitude), INVALID_ARGUMENT);
    CHECK(allocations == before);

    plumbline_ahrs_free(other);
    plumbline_ahrs_free(NULL);
    free(snapshot);
    free(memory);
    puts("ok");
    return 0;
}
