// The same as the browser's own, where it has one; reads QR codes only.
declare const Reader: typeof BarcodeDetector;
export { Reader as BarcodeDetector };
