/* infer_apart: how well parts of what is seen are foretold by what is far from them. */
#include "infer_private.h"

/* What is nearer to the middle of a part than this share of the size does not foretell it: errors of facets and of
 * coarse cells are alike over shorter distances. */
#define REGI_INFER_APART ((sb_real)0.2)

static sb_real regi_infer_between(const reg_infer *f, int a, int b)
{
    return sb_v3_norm(sb_v3_sub(regi_infer_seen_at(f, a), regi_infer_seen_at(f, b)));
}

/* Middles as far from each other as can be, from the first on; each datum to the nearest. */
REGI_API void regi_infer_cut_parts(reg_infer *f)
{
    int count = 0;
    while (count < f->gauss.count && f->patch_of[count] >= 0)
        f->datum[count++] = (double)SB_REAL_MAX;
    for (f->part_count = 0; f->part_count < REGI_INFER_PARTS; f->part_count++) {
        int middle = 0;
        for (int i = 1; i < count; i++)
            middle = f->datum[i] > f->datum[middle] ? i : middle;
        if (count == 0 || !(f->datum[middle] > 0))
            break;
        f->parts[f->part_count] = middle;
        for (int i = 0; i < count; i++) {
            double way = (double)regi_infer_between(f, i, middle);
            if (way < f->datum[i]) {
                f->datum[i] = way;
                f->part[i] = f->part_count;
            }
        }
    }
}

/* left: what is near the middle of a part, the part itself last. Returns how many; *told: of the part. */
static int regi_infer_leave_out(const reg_infer *f, int part, int *told)
{
    sb_real reach = REGI_INFER_APART * f->model->size;
    int count = 0, near;
    for (int i = 0; i < f->gauss.count && f->patch_of[i] >= 0; i++)
        if (f->part[i] != part && regi_infer_between(f, i, f->parts[part]) < reach)
            f->left[count++] = i;
    near = count;
    for (int i = 0; i < f->gauss.count && f->patch_of[i] >= 0; i++)
        if (f->part[i] == part)
            f->left[count++] = i;
    *told = count - near;
    return count;
}

REGI_API int regi_infer_foretell(reg_infer *f, double *density)
{
    *density = 0;
    if (!regi_gauss_set_apart(&f->gauss))
        return 0;
    for (int part = 0; part < f->part_count; part++) {
        int told, count = regi_infer_leave_out(f, part, &told);
        if (!regi_gauss_foretell(&f->gauss, f->left, count, told, density))
            return 0;
    }
    return 1;
}
