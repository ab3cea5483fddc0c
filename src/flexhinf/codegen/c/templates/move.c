/* Copy numbers from one place to another; the places may overlap. */
static void @{name}(const @{R} *source, @{R} *target, int count)
{
    if (source < target) {
        for (int i = count - 1; i >= 0; --i) {
            target[i] = source[i];
        }
    } else {
        for (int i = 0; i < count; ++i) {
            target[i] = source[i];
        }
    }
}
