/* Copy numbers from one place to another, apart from it. */
static void @{name}(const @{R} *RESTRICT source, @{R} *RESTRICT target, int count)
{
    for (int i = 0; i < count; ++i) {
        target[i] = source[i];
    }
}
