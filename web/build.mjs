// Build the page into a folder: node build.mjs FOLDER. The robot's own files are the export's business.
import { copyFileSync, mkdirSync } from 'node:fs';
import { dirname, join } from 'node:path';
import { fileURLToPath } from 'node:url';
import { build } from 'esbuild';

const here = dirname(fileURLToPath(import.meta.url));
const out = process.argv[2];
mkdirSync(out, { recursive: true });
await build({
  entryPoints: [join(here, 'src/main.js')],
  outfile: join(out, 'main.js'),
  bundle: true,
  minify: true,
  format: 'esm',
  target: 'es2022',
  external: ['module', 'node:*', 'fs', 'path', 'worker_threads'], // looked for under Node.js alone
  legalComments: 'eof',
  logLevel: 'warning',
});
for (const file of ['index.html', 'style.css']) copyFileSync(join(here, 'src', file), join(out, file));
const modules = join(here, 'node_modules');
copyFileSync(join(modules, '@mujoco/mujoco/mujoco.wasm'), join(out, 'mujoco.wasm'));
for (const end of ['wasm', 'mjs']) {
  const name = `ort-wasm-simd-threaded.${end}`;
  copyFileSync(join(modules, 'onnxruntime-web/dist', name), join(out, name));
}
