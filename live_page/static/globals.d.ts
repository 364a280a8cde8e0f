// What the page's scripts find in the browser, for `make check-scripts`.
declare const uPlot: any;
