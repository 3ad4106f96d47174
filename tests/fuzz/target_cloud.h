/* Target: clouds in memory, and the cloud that comes out is used. */
#ifndef TARGET_CLOUD_H
#define TARGET_CLOUD_H

#include "fuzz.h"

#include "register.h"

static void fuzz_use_cloud(reg_cloud *cloud)
{
    reg_cloud thin;
    int count = cloud->count;
    FUZZ_REQUIRE(count > 0 && fuzz_all_finite(cloud->points, count));
    FUZZ_REQUIRE(!cloud->normals || fuzz_all_finite(cloud->normals, count));
    FUZZ_REQUIRE(reg_cloud_save_ply("/dev/null", cloud, 1, NULL) == SB_OK);
    if (reg_cloud_thin(cloud, (sb_real)0.1, &thin, NULL) == SB_OK) {
        FUZZ_REQUIRE(thin.count > 0 && thin.count <= count);
        reg_cloud_free(&thin);
    }
    if (reg_cloud_estimate_normals(cloud, 4, NULL, NULL, NULL) == SB_OK)
        FUZZ_REQUIRE(fuzz_all_finite(cloud->normals, count));
    if (reg_cloud_remove_outliers(cloud, 3, REG_OUTLIERS_MEDIAN, 3, NULL, NULL) == SB_OK)
        FUZZ_REQUIRE(cloud->count > 0 && cloud->count <= count);
}

/* The first byte says which format is claimed. */
static void fuzz_cloud(const uint8_t *data, size_t size)
{
    reg_cloud cloud;
    sb_error error;
    sb_result result;
    if (size == 0)
        return;
    memset(&cloud, 0, sizeof cloud);
    result =
        reg_cloud_load_memory(&cloud, data + 1, size - 1, (reg_cloud_format)(data[0] % 4), "fuzz", 1, NULL, &error);
    if (result != SB_OK) {
        FUZZ_REQUIRE(cloud.points == NULL && cloud.normals == NULL);
        FUZZ_REQUIRE(error.result == result && error.message[0]);
        return;
    }
    fuzz_use_cloud(&cloud);
    reg_cloud_free(&cloud);
}

#endif /* TARGET_CLOUD_H */
