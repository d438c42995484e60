// A pair of a tile and a splat. Where 16 bits hold either, one word has both: the splat below, and above it the place
// of the pair among the splat's slots. Else (PACKED 0) it is the splat alone, and slots have a list of their own.
uint isect_splat(uint word) {
    return PACKED == 1u ? word & 0xffffu : word;
}

uint isect_word(uint splat, uint place) {
    return PACKED == 1u ? splat | place << 16 : splat;
}

// Where the pair's slot is, from the first of its splat; of packed pairs only.
uint isect_place(uint word) {
    return word >> 16;
}
