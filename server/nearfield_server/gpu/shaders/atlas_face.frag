#version 430
// Number of the triangle; exact in float32 below 2^24.
out float outFace;

void main() {
    outFace = float(gl_PrimitiveID);
}
