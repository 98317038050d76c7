// Drive the page as a person would, for the tests: node drive.mjs URL FOLDER. Pictures go into the folder; what was
// read goes to stdout as JSON. CHROMIUM names the browser.
import { join } from 'node:path';
import { chromium } from 'playwright-core';

const [url, folder] = process.argv.slice(2);
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
  args: [
    '--headless', '--no-sandbox', '--disable-gpu', '--enable-unsafe-swiftshader', '--disable-quic', '--no-first-run',
    '--disable-background-networking', '--disable-component-update', '--disable-sync',
  ],
});
const found = { errors: [] };
try {
  const page = await browser.newPage({ viewport: { width: 1180, height: 720 } });
  page.setDefaultTimeout(600000);
  page.on('pageerror', (error) => found.errors.push(String(error)));
  page.on('requestfailed', (request) => found.errors.push(`not served: ${request.url()}`));
  page.on('request', (request) => {
    if (!request.url().startsWith(url) && !/^(data|blob):/.test(request.url())) found.errors.push(request.url());
  });
  // All at one instant: in a hurry seconds pass between two looks.
  const read = () =>
    page.evaluate(() => {
      const text = (id) => document.querySelector(`#${id}`).textContent;
      const numbers = ['time', 'distance', 'falls', 'now', 'speed', 'froude'].map((id) => [id, Number(text(id))]);
      return { ...Object.fromEntries(numbers), gait: text('name') };
    });
  const until = (time) => page.waitForFunction((end) => Number(document.querySelector('#time').textContent) >= end, time);
  const picture = (name) => page.screenshot({ path: join(folder, `${name}.png`) });
  // Mean speed over the last seconds of some time at a stride frequency, which the number field is set to.
  const at = async (name, frequency, seconds, mean) => {
    await page.fill('#frequency', String(frequency));
    await page.press('#frequency', 'Enter');
    const { time: start } = await read();
    await until(start + seconds - mean);
    const from = await read();
    await until(start + seconds);
    const to = await read();
    found[name] = { ...to, mean: (to.distance - from.distance) / (to.time - from.time) };
    await picture(name);
  };

  await page.goto(`${url}?speed=max`);
  await page.waitForSelector('#loading', { state: 'detached' });
  await at('walk', 0.9, 20, 10);
  await at('run', 1.3, 20, 10);
  await page.check('input[value=uneven]');
  await at('uneven', 1.1, 8, 5);
  await page.goto(url);
  await page.waitForSelector('#loading', { state: 'detached' });
  await until(1);
  // A person's clicks wait for pictures, which come slowly without a graphics card: the arrow would be gone.
  await page.dispatchEvent('#push', 'click');
  await page.waitForTimeout(300);
  await page.dispatchEvent('#pause', 'click');
  await picture('push');
  const { time: paused } = await read();
  await page.waitForTimeout(500);
  found.paused = (await read()).time - paused;
} finally {
  await browser.close();
}
console.log(JSON.stringify(found));
