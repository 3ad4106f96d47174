/* The script of tests/web/page.mjs by the native compiler: prints the hash of the state after each tool, and what it
 * read. */
#include "../../examples/web/page.c"

static void frames(int count)
{
    for (int i = 0; i < count; i++)
        if (!page_step(1.0 / 60))
            printf("frame: %s\n", page_message());
}

int main(void)
{
    if (!page_make(10))
        return printf("%s\n", page_message()), 1;
    frames(5);
    for (int tool = 0; tool < 4; tool++) {
        double most = 0;
        if (!page_press(tool, 0.01, 0.005, 0.3, 0, 0, -1))
            return printf("tool %d: %s\n", tool, page_message()), 1;
        for (int i = 0; i < 40; i++) {
            page_move(0.01 + (tool == 3 ? 0 : 0.001 * i), 0.005 + (tool == 2 ? 0.002 * i : 0), 0.3, 0, 0, -1);
            frames(1);
            most = page_force() > most ? page_force() : most;
        }
        page_release();
        frames(10);
        printf("%d %08x %d %.9g\n", tool, (unsigned)page_hash(), page_vertex_count(), most);
    }
    page_free();
    return 0;
}
